"""κ, what the filter shows of a gyro scale error, beside the filter itself over a simulated move."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.regression.motion import filter_share
from calrig.estimation.kalman import KalmanFilter, KalmanNoise

GAIN = 0.01
STILL_S = 20.0
"""Before the move, for the filter to have settled."""


def trapezoid_deg(time_s, move_deg, velocity_dps, acceleration_dps2):
    """(n,) the stage's angle, and how long the move takes."""
    peak_dps = min(velocity_dps, np.sqrt(move_deg * acceleration_dps2))
    ramp_s = peak_dps / acceleration_dps2
    level_s = move_deg / peak_dps - ramp_s
    gained = np.clip(time_s, 0.0, ramp_s), np.clip(time_s - ramp_s, 0.0, level_s)
    slowed = np.clip(time_s - ramp_s - level_s, 0.0, ramp_s)
    up, level = 0.5 * acceleration_dps2 * gained[0] ** 2, peak_dps * gained[1]
    down = peak_dps * slowed - 0.5 * acceleration_dps2 * slowed**2
    return up + level + down, 2.0 * ramp_s + level_s


@pytest.mark.parametrize("move_deg", [5.0, 60.0])
@pytest.mark.parametrize(
    ("filtering", "settle_s"),
    [
        (Filtering(), 1.0),
        (Filtering(KalmanNoise(r_deg2=0.3)), 1.0),
        (Filtering(KalmanNoise(q_angle=0.01, q_bias=0.0003), rate_hz=100.0, dwell_s=1.0), 0.3),
    ],
)
def test_a_gyro_that_is_wrong_by_one_percent_shows_in_the_reading_as_kappa_says(
    filtering, settle_s, move_deg
):
    dt_s = 1.0 / filtering.rate_hz
    _, took_s = trapezoid_deg(np.zeros(1), move_deg, 20.0, 80.0)
    time_s = np.arange(0.0, STILL_S + took_s + settle_s + filtering.dwell_s, dt_s)
    angle_deg, _ = trapezoid_deg(time_s - STILL_S, move_deg, 20.0, 80.0)
    rate_dps = (1.0 + GAIN) * np.diff(angle_deg, prepend=0.0) / dt_s
    filtered_deg = KalmanFilter(filtering.noise).run(time_s + dt_s, angle_deg, rate_dps)
    dwell = time_s >= STILL_S + took_s + settle_s
    shown = float((filtered_deg - angle_deg)[dwell].mean()) / (GAIN * move_deg)

    at_s = took_s + settle_s + filtering.dwell_s
    poses = [
        Pose(angle, angle, time_s=middle_s, settle_s=settle_s, filtering=filtering)
        for angle, middle_s in ((0.0, 0.0), (move_deg, at_s))
    ]

    assert filter_share(poses)[1] == pytest.approx(shown, abs=0.006)


@pytest.mark.parametrize("rate_hz", [100.0, 200.0])
@pytest.mark.parametrize("gain", [-0.02, 0.005, 0.025])
def test_that_the_filter_goes_on_by_the_newest_rate_counts_where_the_gyro_tells_its_gain(rate_hz, gain):
    filtering = Filtering(rate_hz=rate_hz)
    fine_s = np.arange(0.0, 1.0, 1e-4)
    turned_deg, took_s = trapezoid_deg(fine_s, 10.0, 20.0, 80.0)
    time_s = np.arange(0.0, STILL_S + took_s + 3.0, 1.0 / rate_hz) + 3e-4
    angle_deg = np.interp(time_s - STILL_S, fine_s, turned_deg)
    rate_dps = np.interp(time_s - STILL_S, fine_s, np.gradient(turned_deg, fine_s), right=0.0)
    filtered_deg = KalmanFilter().run(time_s, angle_deg, (1.0 + gain) * rate_dps)
    dwell = time_s >= STILL_S + took_s + 1.0
    shown = float((filtered_deg - angle_deg)[dwell].mean()) / 10.0
    poses = [
        Pose(angle, angle, time_s=middle_s, settle_s=1.0, filtering=filtering, gyro_move_deg=felt_deg)
        for angle, middle_s, felt_deg in ((0.0, 0.0, None), (10.0, took_s + 3.0, 10.0 * (1.0 + gain)))
    ]
    assert gain * filter_share(poses)[1] == pytest.approx(shown, abs=3e-5)


@pytest.mark.parametrize("waited_s", [0.0, 0.3])
def test_what_lies_between_two_dwells_beside_the_stages_turn_is_settling(waited_s):
    time_s = np.arange(0.0, STILL_S + 5.0, 0.005)
    angle_deg, took_s = trapezoid_deg(time_s - STILL_S, 10.0, 20.0, 80.0)
    rate_dps = (1.0 + GAIN) * np.diff(angle_deg, prepend=0.0) / 0.005
    filtered_deg = KalmanFilter().run(time_s + 0.005, angle_deg, rate_dps)
    begins_s = STILL_S + took_s + waited_s + 1.0
    dwell = (time_s >= begins_s) & (time_s < begins_s + 2.0)
    shown = float((filtered_deg - angle_deg)[dwell].mean()) / (GAIN * 10.0)
    known = Filtering(velocity_dps=20.0, acceleration_dps2=80.0)
    poses = [
        Pose(angle, angle, time_s=middle_s, settle_s=1.0, filtering=known)
        for angle, middle_s in ((0.0, 0.0), (10.0, took_s + waited_s + 3.0))
    ]
    assert filter_share(poses)[1] == pytest.approx(shown, abs=0.0015)


def test_what_a_pose_does_not_know_of_its_filter_is_the_contracts():
    known = Pose(0.0, 0.0, settle_s=1.0, filtering=Filtering(KalmanNoise(0.001, 0.003, 0.03), 200.0, 2.0))
    assert filter_share([Pose(0.0, 0.0)]) == pytest.approx(filter_share([known]))


def test_a_dwell_that_ended_early_counts_as_long_as_it_was():
    short, planned = Filtering(dwell_s=1.0), Filtering(dwell_s=4.0)
    early = Pose(0.0, 0.0, n_samples=200, filtering=planned)
    assert filter_share([early]) == pytest.approx(filter_share([Pose(0.0, 0.0, filtering=short)]))
