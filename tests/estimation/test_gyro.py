"""The gyro's bias from dwells and its scale from moves."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from scipy.stats import chi2

from calrig.estimation.gyro import (
    GyroBias,
    dwell_bias,
    felt_move_deg,
    gyro_scale,
    integration_error_deg,
    move_angle_deg,
    run_bias,
)
from calrig.instruments.axis import travel_time_s
from calrig.runs.pose_acquisition import OwnGyro
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings


@pytest.mark.statistical
def test_a_dwells_bias_scatters_by_its_stated_error():
    true_dps = np.array([1.5, -0.3, 0.0])
    biases = [
        dwell_bias(true_dps + np.random.default_rng(seed).normal(0.0, 0.07, (400, 3))) for seed in range(300)
    ]
    off_dps = np.array([bias.bias_dps for bias in biases]) - true_dps
    stated_dps = np.array([bias.bias_std_dps for bias in biases])

    in_stated_variances = (off_dps**2).sum() / (stated_dps**2).mean()

    assert chi2.ppf(1e-3, 900) < in_stated_variances < chi2.ppf(1.0 - 1e-3, 900)


@pytest.mark.parametrize("slip_s", [0.05, 0.2])
def test_a_slip_within_a_dwell_is_no_bias(slip_s):
    time_s = np.arange(400) / 200.0
    quiet_dps = 0.3 + np.random.default_rng(4).normal(0.0, 0.05, (400, 3))
    slipping = (time_s >= 0.8) & (time_s < 0.8 + slip_s)
    slipped_dps = quiet_dps + np.outer(slipping, [0.05 / slip_s, 0.0, 0.0])
    quiet, slipped = dwell_bias(quiet_dps), dwell_bias(slipped_dps)
    assert slipped.bias_dps[1:] == quiet.bias_dps[1:]
    assert slipped.bias_dps[0] == pytest.approx(quiet.bias_dps[0], abs=0.002)
    assert slipped_dps[:, 0].mean() > quiet_dps[:, 0].mean() + 0.02


def test_an_axis_that_is_not_sent_is_not_known():
    gyro_dps = np.random.default_rng(0).normal(0.0, 0.1, (50, 3))
    gyro_dps[:, 2] = np.nan

    bias = dwell_bias(gyro_dps)

    assert bias.bias_dps[2] is None
    assert bias.bias_std_dps[2] is None
    assert None not in bias.bias_dps[:2] + bias.bias_std_dps[:2]


def test_a_dwell_of_a_few_samples_has_a_bias_without_an_error():
    bias = dwell_bias(np.ones((3, 3)))
    assert bias == GyroBias((1.0, 1.0, 1.0), (None, None, None))


def test_a_runs_bias_feels_what_wanders_between_dwells():
    bias = run_bias(np.array([[x, 0.0, np.nan] for x in (1.0, 1.2, 1.4)]))

    assert bias.bias_dps == (pytest.approx(1.2), 0.0, None)
    assert bias.bias_std_dps == (pytest.approx(0.2 / math.sqrt(3)), 0.0, None)


def test_one_dwell_tells_no_scatter_and_none_tell_no_bias():
    assert run_bias(np.array([[1.0, 2.0, 3.0]])) == GyroBias((1.0, 2.0, 3.0), (None, None, None))
    assert run_bias(np.empty((0, 3))) == GyroBias((None, None, None), (None, None, None))


def test_a_run_of_one_dwell_has_that_dwells_bias_and_its_error():
    only = GyroBias((1.0, 2.0, 3.0), (0.1, 0.1, 0.1))
    gyro = OwnGyro(0, [only]).figures([], [])
    assert (tuple(gyro.bias_dps), tuple(gyro.bias_std_dps)) == (only.bias_dps, only.bias_std_dps)


def test_a_move_is_the_integral_of_rate_less_bias_on_an_uneven_clock():
    """A rate that rises and falls in straight lines: trapezoids give its integral exactly."""
    time_s = np.array([0.0, 0.1, 0.5, 0.9, 1.3, 2.0, 2.5])
    rate_dps = np.interp(time_s, [0.5, 1.3, 2.0], [0.0, 20.0, 0.0])

    angle_deg = move_angle_deg(time_s, rate_dps + 0.75, 0.75)

    assert angle_deg == pytest.approx(20.0 * (2.0 - 0.5) / 2.0)


def test_a_move_without_samples_or_gyro_is_not_known():
    assert move_angle_deg(np.zeros(1), np.zeros(1), 0.0) is None
    assert move_angle_deg(np.arange(3.0), np.array([0.0, np.nan, 0.0]), 0.0) is None


def test_a_move_with_a_gap_in_it_is_not_known():
    time_s = np.array([0.0, 0.1, 0.2, 0.6, 0.7])
    assert move_angle_deg(time_s, np.ones(5), 0.0, gap_s=0.5) == pytest.approx(0.7)
    assert move_angle_deg(time_s, np.ones(5), 0.0, gap_s=0.3) is None


PROFILES = [(20.0, 80.0), (60.0, 240.0), (180.0, 1000.0)]
"""Velocity in °/s and acceleration in °/s²."""


def simulated_move(rate_hz, velocity_dps, acceleration_dps2, turn_deg, phase):
    """Times and rates of a sensor that rests a second, turns, and rests again; `phase` of a period late."""
    bench = Bench(SimulatorSettings.from_options({"preset": "ideal", "seed": 1}))
    rests_s = bench.mechanics.home(0.0, 200.0, 800.0).at_s
    ends_s = bench.mechanics.move(rests_s + 1.0, turn_deg, velocity_dps, acceleration_dps2).at_s
    time_s = np.arange(rests_s + phase / rate_hz, ends_s + 1.0, 1.0 / rate_hz)
    return time_s, bench.counts(time_s, rate_hz)[:, 4] * (250.0 / 32768.0)


@pytest.mark.parametrize("rate_hz", [10, 20, 50, 100, 200])
def test_a_move_that_the_rate_cannot_carry_is_not_known_and_any_other_is_right(rate_hz):
    """Over stages and turns, each begun at six places between two samples."""
    known = 0
    for (velocity_dps, acceleration_dps2), turn_deg in product(PROFILES, (1.0, 5.0, 20.0, 40.0)):
        lasts_s = travel_time_s(turn_deg, velocity_dps, acceleration_dps2)
        for phase in np.arange(6) / 6:
            time_s, rate_dps = simulated_move(rate_hz, velocity_dps, acceleration_dps2, turn_deg, phase)
            felt_deg = felt_move_deg(time_s, rate_dps, 0.0, 1.0 / rate_hz, lasts_s)
            if felt_deg is not None:
                known += 1
                assert abs(felt_deg - turn_deg) <= max(0.03, 0.005 * turn_deg), (
                    velocity_dps,
                    turn_deg,
                    phase,
                )
    assert known == {10: 0, 200: 72}.get(rate_hz, known)
    assert rate_hz == 10 or known > 0


@pytest.mark.parametrize(("velocity_dps", "acceleration_dps2"), PROFILES)
@pytest.mark.parametrize("rate_hz", [20, 50, 200])
def test_the_integrals_error_is_within_what_its_samples_show(rate_hz, velocity_dps, acceleration_dps2):
    """Wherever between two samples a ramp of at least a period begins: no noise, the profile itself."""
    ramp_s = velocity_dps / acceleration_dps2
    corners_s = np.cumsum([0.5, ramp_s, 0.5, ramp_s])
    angle_deg = velocity_dps * (0.5 + ramp_s)
    for phase in np.arange(12) / 12:
        time_s = np.arange(phase / rate_hz, corners_s[-1] + 0.5, 1.0 / rate_hz)
        rate_dps = np.interp(time_s, corners_s, [0.0, velocity_dps, velocity_dps, 0.0])
        error_deg = abs(move_angle_deg(time_s, rate_dps, 0.0) - angle_deg)
        assert error_deg <= integration_error_deg(time_s, rate_dps) + 1e-9


@pytest.mark.parametrize(("missing", "known"), [(0, True), (1, True), (2, False), (20, False), (200, False)])
def test_a_move_with_missing_samples_is_not_known_but_one_alone_is_bridged(missing, known):
    time_s, rate_dps = simulated_move(200, 20.0, 80.0, 20.0, 0.0)
    kept = np.ones(len(time_s), dtype=bool)
    kept[240 : 240 + missing] = False  # from the middle of the move on

    felt_deg = felt_move_deg(time_s[kept], rate_dps[kept], 0.0, 1 / 200)

    assert (felt_deg is not None) == known
    assert felt_deg is None or felt_deg == pytest.approx(20.0, abs=0.05)


def test_a_move_that_may_have_passed_between_two_samples_is_not_known():
    time_s = np.arange(0.0, 3.0, 0.1)
    assert felt_move_deg(time_s, np.zeros(30), 0.0, 0.1, lasts_s=0.15) is None
    assert felt_move_deg(time_s, np.zeros(30), 0.0, 0.1, lasts_s=0.0) == 0.0


def test_gyro_scale_is_found_and_scatters_by_its_stated_error():
    """The stage turns 10° a move; the gyro feels 1/1.02 of it, give or take 0.05°."""
    turned_deg = np.tile([10.0, -10.0, 0.0], 17)
    found = [
        gyro_scale(turned_deg, turned_deg / 1.02 + np.random.default_rng(seed).normal(0.0, 0.05, 51))
        for seed in range(300)
    ]
    off = np.array([one.scale for one in found]) - 1.02
    stated = np.array([one.scale_std for one in found])

    assert chi2.ppf(1e-3, 300) < (off @ off) / np.mean(stated**2) < chi2.ppf(1.0 - 1e-3, 300)


@pytest.mark.parametrize(
    ("turned_deg", "felt_deg"), [([], []), ([0.0, 0.2], [0.1, 0.1]), ([10.0], [0.0]), ([10.0], [np.nan])]
)
def test_without_a_turn_there_is_no_gyro_scale(turned_deg, felt_deg):
    assert gyro_scale(turned_deg, felt_deg) is None


def test_one_move_gives_a_scale_without_an_error():
    found = gyro_scale([10.0, np.nan], [9.8, 9.0])
    assert found is not None
    assert (found.scale, found.scale_std) == (pytest.approx(10.0 / 9.8), None)


@pytest.mark.parametrize("moves", [2, 3, 9])
def test_the_error_of_the_gyro_scale_is_that_of_a_regression_through_the_origin(moves):
    rng = np.random.default_rng(7)
    felt_deg = rng.uniform(-40.0, 40.0, moves)
    turned_deg = 1.02 * felt_deg + rng.normal(0.0, 0.1, moves)
    (slope,), (power,), _, _ = np.linalg.lstsq(felt_deg[:, None], turned_deg, rcond=None)
    found = gyro_scale(turned_deg, felt_deg)
    assert found.scale == pytest.approx(slope)
    assert found.scale_std == pytest.approx(math.sqrt(power / (moves - 1) / (felt_deg @ felt_deg)))


@pytest.mark.parametrize(("standard_errors", "is_left_out"), [(4.0, False), (6.0, True)])
def test_a_block_is_an_outlier_from_five_standard_errors_of_its_mean_on(standard_errors, is_left_out):
    """Twenty blocks of 100 samples of white noise, each without a mean of its own but one."""
    blocks = np.random.default_rng(8).standard_normal((20, 100))
    blocks -= blocks.mean(axis=1, keepdims=True)
    blocks[11] += standard_errors / math.sqrt(100.0)
    found_dps = dwell_bias(np.column_stack([blocks.ravel()] * 3)).bias_dps[0]
    assert found_dps == pytest.approx(0.0 if is_left_out else standard_errors / 10.0 / 20.0, abs=1e-12)
