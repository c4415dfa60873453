"""The fit recovers bias and scale, and its stated standard errors are what estimates scatter by."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, linregress

from calrig.calibration.correlated_errors import expected_widening
from calrig.calibration.line import fit_line, reading_error_deg, residuals_deg, rms

GRID_DEG = np.tile(np.arange(-60.0, 61.0, 10.0), 4)


@settings(max_examples=200, deadline=None)
@given(
    bias_deg=st.floats(-179.0, 179.0),
    scale=st.floats(0.5, 1.3),
    theta_deg=st.lists(st.floats(-90.0, 90.0), min_size=2, max_size=30).filter(lambda x: np.ptp(x) > 1.0),
)
@example(bias_deg=0.0, scale=0.5, theta_deg=[1.5, 1e-300, 1.5])
def test_exact_readings_give_back_bias_and_scale(bias_deg, scale, theta_deg):
    theta_deg = np.array(theta_deg)
    unwrapped_deg = bias_deg + scale * theta_deg
    reading_deg = np.degrees(np.angle(np.exp(1j * np.radians(unwrapped_deg))))

    line = fit_line(theta_deg, reading_deg)

    turn_apart = (line.bias_deg - bias_deg + 180.0) % 360.0 - 180.0
    assert turn_apart == pytest.approx(0.0, abs=1e-6)
    assert line.scale == pytest.approx(scale, abs=1e-8)
    left_deg = residuals_deg(theta_deg, reading_deg, line.bias_deg, line.scale)
    np.testing.assert_allclose(left_deg, 0.0, atol=1e-8)


@pytest.mark.statistical
def test_estimates_scatter_by_their_stated_standard_errors():
    """1500 runs on a grid that is not about 0, so that bias and scale are correlated."""
    theta_deg = np.tile(np.arange(-20.0, 61.0, 10.0), 16)
    truth = np.array([0.8, 1.004])
    off, stated = [], []
    rng = np.random.default_rng(5)
    for _ in range(1500):
        noise_deg = rng.normal(0.0, 0.05, len(theta_deg))
        line = fit_line(theta_deg, truth[0] + truth[1] * theta_deg + noise_deg)
        off.append([line.bias_deg - truth[0], line.scale - truth[1]])
        stated.append(line.covariance)
        assert (line.bias_std_deg, line.scale_std) == pytest.approx(np.sqrt(np.diag(line.covariance)))
    off = np.array(off)
    covariance = np.mean(stated, axis=0)

    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], 1500)
    for axis in range(2):
        assert low < (off[:, axis] ** 2).sum() / covariance[axis, axis] < high
    jointly = np.einsum("ni,ij,nj->", off, np.linalg.inv(covariance), off)
    assert chi2.ppf(1e-3, 3000) < jointly < chi2.ppf(1.0 - 1e-3, 3000)


def test_line_and_errors_equal_an_independent_regression():
    rng = np.random.default_rng(2)
    theta_deg = rng.uniform(-60.0, 60.0, 40)
    reading_deg = 1.0 + 0.99 * theta_deg + rng.normal(0.0, 0.1, 40)

    line, expected = fit_line(theta_deg, reading_deg), linregress(theta_deg, reading_deg)

    assert (line.bias_deg, line.scale) == pytest.approx((expected.intercept, expected.slope), rel=1e-10)
    stated = line.bias_std_deg / expected.intercept_stderr, line.scale_std / expected.stderr
    assert stated == pytest.approx(expected_widening(40)[1:], rel=0.25), "in white noise a little larger"


@pytest.mark.parametrize("told", [True, False])
def test_at_one_angle_scale_is_unknown_and_bias_is_the_mean(told):
    """With the stage's own noise on θ, only the plan knows that nothing was meant to turn."""
    rng = np.random.default_rng(3)
    theta_deg = 10.0 + (rng.normal(0.0, 0.01, 50) if told else np.zeros(50))
    reading_deg = theta_deg + 0.25 + rng.normal(0.0, 0.06, 50)

    line = fit_line(theta_deg, reading_deg, one_angle=told)

    error_deg = reading_deg - theta_deg
    assert (line.scale, line.scale_std, line.covariance) == (None, None, None)
    assert line.bias_deg == pytest.approx(error_deg.mean())
    assert line.bias_std_deg == pytest.approx(error_deg.std(ddof=1) / math.sqrt(50), rel=0.2)


def test_one_pose_gives_a_bias_and_two_give_a_line_both_without_errors():
    one = fit_line(np.array([10.0]), np.array([10.5]))
    assert (one.bias_deg, one.bias_std_deg, one.scale, one.residual_std_deg) == (0.5, None, None, None)

    two = fit_line(np.array([0.0, 10.0]), np.array([0.5, 10.4]))
    assert (two.bias_deg, two.scale) == pytest.approx((0.5, 0.99))
    assert (two.bias_std_deg, two.scale_std, two.covariance) == (None, None, None)


def test_a_unit_mounted_upside_down_has_a_bias_of_half_a_turn():
    rng = np.random.default_rng(4)
    reading_deg = (GRID_DEG + rng.normal(0.0, 0.05, len(GRID_DEG))) % 360.0 - 180.0

    line = fit_line(GRID_DEG, reading_deg)

    assert abs(line.bias_deg) == pytest.approx(180.0, abs=0.05)
    assert -180.0 < line.bias_deg <= 180.0
    assert line.scale == pytest.approx(1.0, abs=0.001)
    assert rms(residuals_deg(GRID_DEG, reading_deg, line.bias_deg, line.scale)) < 0.1


def test_an_axis_turned_round_has_a_scale_of_minus_one():
    line = fit_line(GRID_DEG, 0.3 - GRID_DEG)
    assert (line.bias_deg, line.scale) == pytest.approx((0.3, -1.0))


@pytest.mark.parametrize("turns", [1, 3])
@pytest.mark.parametrize("bias_deg", [0.0, 95.0, 179.0])
def test_a_sensor_that_counts_against_the_stage_is_followed_over_the_ends_of_its_turns(bias_deg, turns):
    theta_deg = np.linspace(0.0, turns * 360.0, 73)
    reading_deg = (bias_deg - 1.002 * theta_deg + 180.0) % 360.0 - 180.0

    line = fit_line(theta_deg, reading_deg)

    assert (line.bias_deg, line.scale) == pytest.approx((bias_deg, -1.002))
    assert line.follows


def test_readings_at_random_on_a_turn_do_not_follow_the_stage_whatever_line_they_give():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        theta_deg = rng.uniform(0.0, 360.0, 60)
        assert not fit_line(theta_deg, rng.uniform(-180.0, 180.0, 60)).follows


def test_readings_that_do_not_follow_the_stage_leave_no_residual_to_state():
    line = fit_line(GRID_DEG, np.full(len(GRID_DEG), 3.0))

    assert line.scale == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(residuals_deg(GRID_DEG, np.full(len(GRID_DEG), 3.0), line.bias_deg, line.scale)).all()


@pytest.mark.parametrize("seed", range(20))
def test_readings_of_noise_alone_do_not_follow_the_stage_and_those_of_volts_do(seed):
    noise = np.random.default_rng(seed).normal(0.0, 0.02, len(GRID_DEG))
    stuck, volts = fit_line(GRID_DEG, 3.0 + noise), fit_line(GRID_DEG, 0.0278 * GRID_DEG + 0.01 * noise)

    assert not stuck.follows
    assert np.isnan(stuck.left_deg(GRID_DEG, 3.0 + noise)).all()
    assert volts.follows


def test_a_scale_that_few_poses_tell_badly_is_one_all_the_same():
    line = fit_line(np.array([-0.5, 0.0, 0.5]), np.array([-0.8, 0.6, 0.6]))

    assert line.scale_std is not None
    assert line.scale is not None
    assert abs(line.scale) < 3.0 * line.scale_std
    assert line.follows


@pytest.mark.parametrize(
    ("theta_deg", "reading_deg", "complaint"),
    [([], [], "needs poses"), ([1.0, 2.0], [1.0], "needs poses"), ([1.0, np.nan], [1.0, 1.0], "not finite")],
)
def test_poses_that_cannot_be_fitted_are_refused(theta_deg, reading_deg, complaint):
    with pytest.raises(ValueError, match=complaint):
        fit_line(np.array(theta_deg), np.array(reading_deg))


def test_a_residual_is_in_degrees_of_elevation_not_of_the_reading():
    """A unit that reads two degrees a degree, and 0.5° too much at one pose: its elevation errs by 0.25°."""
    theta_deg = np.array([-30.0, 0.0, 30.0])
    reading_deg = 1.0 + 2.0 * theta_deg + np.array([0.0, 0.5, 0.0])
    np.testing.assert_allclose(residuals_deg(theta_deg, reading_deg, 1.0, 2.0), [0.0, 0.25, 0.0], atol=1e-12)


def test_a_gross_error_of_readings_that_go_on_is_not_folded_and_a_turn_lost_is():
    theta_deg = np.linspace(0.0, 1440.0, 60)
    reading_deg = 5.0 + 1.01 * theta_deg + np.random.default_rng(3).normal(0.0, 0.1, 60)
    some = np.array([7, 30, 44])
    wrong, restarted = reading_deg.copy(), reading_deg.copy()
    wrong[some] += [-746.0, 500.0, 1100.0]
    restarted[some] -= [360.0, 720.0, 1080.0]
    of_line = residuals_deg(theta_deg, wrong, 5.0, 1.01)
    assert of_line == pytest.approx((wrong - 5.0) / 1.01 - theta_deg)
    assert reading_error_deg(theta_deg, wrong) == pytest.approx(wrong - theta_deg)
    assert np.abs(residuals_deg(theta_deg, restarted, 5.0, 1.01)).max() < 0.5
    assert np.ptp(reading_error_deg(theta_deg, restarted) - 0.01 * theta_deg) < 1.0
