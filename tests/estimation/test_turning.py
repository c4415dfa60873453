"""What is read while a stage turns evenly, against a turn made here: a trapezoid with a worm in it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from calrig.estimation.kalman import KalmanFilter, KalmanNoise
from calrig.estimation.turning import (
    ClockLine,
    clock_line,
    common_delay_s,
    even_turn,
    filter_lag_deg,
    gyro_turn,
    hidden_dps,
    scatter_g,
    turn_between,
    turned_back,
)

RATE_HZ = 200.0
FROM_DEG, TO_DEG, VELOCITY_DPS, ACCELERATION_DPS2 = -30.0, 30.0, 5.0, 80.0


def reported_deg(time_s: np.ndarray, acceleration_dps2: float = ACCELERATION_DPS2) -> np.ndarray:
    """A trapezoid from FROM_DEG, begun at 1 s, to TO_DEG."""
    ramp_s = VELOCITY_DPS / acceleration_dps2
    ends_s = (TO_DEG - FROM_DEG) / VELOCITY_DPS + ramp_s
    t = np.clip(time_s - 1.0, 0.0, ends_s)
    up, down = np.minimum(t, ramp_s), np.maximum(t - ends_s + ramp_s, 0.0)
    return FROM_DEG + acceleration_dps2 * (up**2 / 2 - down**2 / 2) + VELOCITY_DPS * (t - up)


def table_deg(time_s: np.ndarray, worm_deg: float) -> np.ndarray:
    """What the table does of it."""
    dial_deg = reported_deg(time_s)
    return dial_deg + worm_deg * np.sin(2 * np.pi * dial_deg / 7.2)


@pytest.mark.parametrize("boards_seconds", [1.0, 0.98, 20.0])
def test_the_hosts_time_becomes_the_boards_whatever_waited_on_its_way(boards_seconds):
    rng = np.random.default_rng(3)
    host_s = np.cumsum(rng.uniform(0.005, 0.04, 400)) + 1e5
    taken_s = host_s - rng.exponential(0.01, 400)  # the last sample that is there, from some time before
    taken_s[100:140] -= np.linspace(1.0, 0.0, 40)  # a machine that was busy elsewhere
    board_s = boards_seconds * (taken_s - 1e5)
    found = clock_line(np.column_stack([host_s, board_s])).board_s(host_s)
    off_s = found - boards_seconds * (host_s - 1e5)
    assert np.ptp(off_s) < 1e-3 * boards_seconds


@pytest.mark.parametrize("worm_deg", [0.0, 0.05])
@pytest.mark.parametrize("behind_s", [-0.02, 0.0, 0.08])
def test_the_age_of_reports_shows_when_the_turn_ends(behind_s, worm_deg):
    rng = np.random.default_rng(7)
    time_s = np.arange(0.0, 15.0, 1.0 / RATE_HZ)
    rate_dps = 1.02 * np.gradient(table_deg(time_s, worm_deg), time_s) + rng.normal(0.0, 0.05, len(time_s))
    asked_s = np.arange(1.0, 13.5, 0.03)
    turn = even_turn(asked_s, reported_deg(asked_s - behind_s), FROM_DEG + 1.0, TO_DEG - 1.0)
    assert turn.velocity_dps == pytest.approx(VELOCITY_DPS, rel=1e-6)
    felt = gyro_turn(time_s, rate_dps, turn, TO_DEG)
    assert felt.behind_s == pytest.approx(behind_s, abs=0.001 if worm_deg == 0.0 else 0.003)
    assert felt.gain == pytest.approx(1.02, abs=0.0005 if worm_deg == 0.0 else 0.003)


def test_passes_share_their_delay_but_for_one_that_a_busy_machine_held_up():
    rng = np.random.default_rng(5)
    clocks = ClockLine(1.01, -3.0)
    board_s = np.arange(20.0, 200.0, 30.0)
    behind_s = 0.02 + rng.normal(0.0, 5e-4, 6)
    behind_s[2] += 0.05
    stands_s = np.column_stack([[clocks.host_s(s) for s in board_s + behind_s], board_s])
    others = np.delete(behind_s, 2)
    assert common_delay_s(stands_s, clocks, 5e-4) == pytest.approx(others.mean(), abs=1e-9)
    assert common_delay_s(stands_s[:3], clocks, 5e-4) == pytest.approx(behind_s[2], abs=1e-9)


@pytest.mark.parametrize("acceleration_dps2", [20.0, 80.0])
@pytest.mark.parametrize("filter_s", [0.0, 0.02])
def test_a_delay_is_right_in_the_mean_and_scatters_as_is_said(acceleration_dps2, filter_s):
    rng = np.random.default_rng(11)
    fine_s = np.arange(0.0, 15.0, 1e-4)
    rate_dps = np.gradient(reported_deg(fine_s, acceleration_dps2), fine_s)
    kept = filter_s / (filter_s + 1e-4)  # so that it delays by filter_s
    filtered_dps = lfilter([1.0 - kept], [1.0, -kept], rate_dps)
    time_s = np.arange(0.0, 15.0, 1.0 / RATE_HZ)
    sampled_dps = np.interp(time_s, fine_s, filtered_dps)
    asked_s = np.arange(1.0, 13.5, 0.03)
    turn = even_turn(asked_s, reported_deg(asked_s, acceleration_dps2), FROM_DEG + 2.0, TO_DEG - 2.0)
    noise_dps = rng.normal(0.0, 0.05, (200, len(time_s)))
    felt = [gyro_turn(time_s, sampled_dps + one, turn, TO_DEG) for one in noise_dps]
    off_s = np.array([one.behind_s for one in felt]) + filter_s
    assert abs(off_s.mean()) < 1e-4  # half a thousandth of a degree
    assert np.mean([one.behind_std_s for one in felt]) == pytest.approx(off_s.std(), rel=0.3)


def test_what_a_gyro_that_gives_too_much_adds_is_what_the_filter_makes_of_it():
    time_s = np.arange(0.0, 16.0, 1.0 / RATE_HZ)
    elevation_deg = table_deg(time_s, 0.0)
    rate_dps = np.gradient(elevation_deg, time_s)
    right, wrong = (KalmanFilter() for _ in range(2))
    still_s = np.arange(-20.0, 0.0, 1.0 / RATE_HZ)
    for one in (right, wrong):
        one.run(still_s, np.full(len(still_s), FROM_DEG), np.zeros(len(still_s)))
    added = wrong.run(time_s, elevation_deg, 1.02 * rate_dps) - right.run(time_s, elevation_deg, rate_dps)
    assert np.abs(added).max() > 0.01
    np.testing.assert_allclose(filter_lag_deg(time_s, 1.02 * rate_dps, 0.02, KalmanNoise()), added, atol=2e-4)


def test_the_mean_of_what_is_turned_back_is_as_long_as_gravity():
    turn_deg = np.linspace(-10.0, 10.0, 2001)
    angle = np.radians(25.0 + turn_deg)
    accel_g = np.stack([np.zeros(2001), np.sin(angle), np.cos(angle)], axis=1)
    x, y, z = turned_back(accel_g, turn_deg).mean(axis=0)
    assert (x, y, z) == pytest.approx((0.0, np.sin(np.radians(25.0)), np.cos(np.radians(25.0))), abs=1e-12)
    assert np.linalg.norm(accel_g.mean(axis=0)) < 0.995


def test_scatter_is_that_of_the_noise_and_not_of_the_turn():
    rng = np.random.default_rng(1)
    turning = np.sin(np.radians(np.linspace(-60.0, 60.0, 4800)))[:, None] + rng.normal(0.0, 0.004, (4800, 3))
    assert scatter_g(turning) == pytest.approx(0.004 * np.sqrt(3.0), rel=0.03)


def test_what_a_coarse_gyro_hides_is_half_of_its_step_unless_noise_carries_it_over():
    rng = np.random.default_rng(4)
    turning_dps = 10.0 + np.linspace(-2.0, 2.0, 500)

    def told(rate_dps, step_dps):
        return np.round(np.asarray(rate_dps) / step_dps) * step_dps

    still_dps = 0.8 + rng.normal(0.0, 0.05, 300)
    assert hidden_dps(told(still_dps, 0.573), told(turning_dps, 0.573)) == pytest.approx(0.2865)
    assert hidden_dps(told(still_dps, 1 / 131), told(turning_dps, 1 / 131)) == 0.0
    assert hidden_dps(told(still_dps, 2000 / 32768), told(turning_dps, 2000 / 32768)) == 0.0
    assert hidden_dps(np.full(300, 0.0), np.full(500, 10.0)) == 0.0


def test_reports_that_are_too_few_are_no_turn():
    with pytest.raises(ValueError, match="2 reports between"):
        even_turn(np.array([0.0, 1.0, 2.0]), np.array([-5.0, 0.0, 5.0]), -5.5, 1.0)


def test_a_turn_from_mean_to_mean_scatters_as_is_said():
    rng = np.random.default_rng(8)
    time_s = np.arange(0.0, 6.0, 0.01)
    angle_deg = np.clip(4.0 * (time_s - 1.0), 0.0, 8.0)
    rate_dps = np.gradient(angle_deg, time_s)
    first_s, second_s = (0.0, 2.0), (4.0, 6.0)
    found = []
    for _ in range(400):
        bias_dps = rng.normal(0.0, 0.002)
        noisy_dps = rate_dps + bias_dps + rng.normal(0.0, 0.05, len(time_s))
        found.append(turn_between(time_s, noisy_dps, first_s, second_s, 0.002))
    turns_deg, stds_deg = np.array(found).T
    assert turns_deg.mean() == pytest.approx(8.0 - angle_deg[time_s <= 2.0].mean(), abs=0.003)
    assert turns_deg.std() == pytest.approx(stds_deg.mean(), rel=0.12)


def test_the_walk_between_the_means_of_two_adjacent_spans_scatters_as_is_said():
    """With a known bias, white noise alone is left, and each span weighs its own by a third."""
    rng = np.random.default_rng(9)
    time_s = np.arange(0.0, 6.0, 0.01)
    noise_dps = rng.normal(0.0, 0.05, (800, len(time_s)))
    found = [turn_between(time_s, one, (0.0, 3.0), (3.0, 6.0), 0.0) for one in noise_dps]
    turns_deg, stds_deg = np.array(found).T
    assert turns_deg.std() == pytest.approx(stds_deg.mean(), rel=0.1)


def test_the_boards_time_is_absolute():
    host_s = np.arange(100.0, 160.0)
    clocks = clock_line(np.column_stack([host_s, 7.0 + 1.001 * host_s]))
    np.testing.assert_allclose(clocks.board_s(host_s), 7.0 + 1.001 * host_s, atol=1e-6)
    assert clocks.host_s(7.0 + 1.001 * 130.0) == pytest.approx(130.0)
