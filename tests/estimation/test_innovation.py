"""The innovation's verdict: silent where the filter fits, and right about what does not."""

from __future__ import annotations

import math

import filterpy.kalman
import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest, norm
from simulated_moves import RATE_HZ, WHITE_ELEVATION, WHITE_GYRO, moves_log

from calrig.estimation.innovation import innovation_check, normalised_innovations
from calrig.estimation.kalman import INITIAL_BIAS_VARIANCE, KalmanNoise
from calrig.estimation.tuning import tuned_noise

DT_S = 1.0 / RATE_HZ
NOISE = tuned_noise(
    white_elevation_deg_sqrt_s=WHITE_ELEVATION, white_gyro_dps_sqrt_s=WHITE_GYRO, rate_hz=RATE_HZ
)


def as_assumed(seed=0, n=12_000, scale=1.0):
    """Exactly what `NOISE` says, but for `scale` times the elevation's standard deviation."""
    white_z, white_u, steps = np.random.default_rng(seed).standard_normal((3, n))
    bias = math.sqrt(NOISE.q_bias * DT_S) * np.cumsum(steps)
    u = bias + math.sqrt(NOISE.q_angle / DT_S) * white_u
    return scale * math.sqrt(NOISE.r_deg2) * white_z, u


def test_innovations_are_those_of_an_independent_filter_from_the_start_on():
    z, u = as_assumed(n=2500)
    oracle = filterpy.kalman.KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
    oracle.x = np.array([[z[0]], [0.0]])
    oracle.P = np.diag([NOISE.r_deg2, INITIAL_BIAS_VARIANCE])
    oracle.H, oracle.R = np.array([[1.0, 0.0]]), np.array([[NOISE.r_deg2]])
    oracle.F, oracle.B = np.array([[1.0, -DT_S], [0.0, 1.0]]), np.array([[DT_S], [0.0]])
    oracle.Q = np.diag([NOISE.q_angle, NOISE.q_bias]) * DT_S
    expected = []
    for elevation_deg, rate_dps in zip(z[1:], u[1:], strict=True):
        oracle.predict(u=np.array([[rate_dps]]))
        oracle.update(np.array([[elevation_deg]]))
        expected.append(float(oracle.y[0, 0] / math.sqrt(oracle.S[0, 0])))

    np.testing.assert_allclose(normalised_innovations(z, u, DT_S, NOISE), expected, atol=1e-6)


@pytest.mark.statistical
def test_p_values_are_uniform_where_the_filter_fits():
    checks = [innovation_check(*as_assumed(seed, n=4000), DT_S, NOISE) for seed in range(150)]

    for tests in ([one.per_sample for one in checks], [one.per_block for one in checks]):
        assert kstest([one.variance_p_value for one in tests], "uniform").pvalue > 1e-3
        assert kstest([one.white_p_value for one in tests], "uniform").pvalue > 1e-3
    assert sum(one.verdict == "consistent" for one in checks) >= 145


def test_the_simulated_chip_at_rest_is_what_the_tuned_filter_assumes():
    log = moves_log((), imu={"gyro_bias_dps": [1.4, 0, 0]})

    assert innovation_check(log.elevation_deg, log.rate_dps, DT_S, NOISE).verdict == "consistent"


@pytest.mark.statistical
def test_the_simulated_chip_is_seldom_found_wanting():
    verdicts = []
    for seed in range(30):
        log = moves_log((), seed=seed, imu={"gyro_bias_dps": [1.4, 0, 0]})
        verdicts.append(innovation_check(log.elevation_deg, log.rate_dps, DT_S, NOISE).verdict)

    assert verdicts.count("consistent") >= 28  # 1 % are expected


def test_the_papers_constants_are_not_this_chips():
    log = moves_log((), imu={"gyro_bias_dps": [1.4, 0, 0]})

    check = innovation_check(log.elevation_deg, log.rate_dps, DT_S, KalmanNoise())

    assert check.verdict == "varies_more"
    assert "not this unit's" in check.sentence


@pytest.mark.parametrize(
    ("scale", "verdict"), [(1.4, "varies_more"), (0.7, "varies_less"), (1.03, "consistent")]
)
def test_a_wrong_variance_is_told_by_its_side_and_a_small_one_forgiven(scale, verdict):
    check = innovation_check(*as_assumed(scale=scale), DT_S, NOISE)

    assert check.verdict == verdict
    assert check.per_sample.variance_ratio == pytest.approx(scale**2, rel=0.05)


def test_a_chips_low_pass_colours_the_samples_and_not_the_filter():
    z, u = as_assumed()
    low_passed = lfilter([0.5], [1.0, -0.5], z)

    check = innovation_check(low_passed, u, DT_S, NOISE)

    assert check.verdict == "low_passed"
    assert check.per_sample.variance_ratio == pytest.approx(1.0 / 3.0, rel=0.1)
    assert check.per_sample.white_p_value < 1e-6
    assert "fits where it acts" in check.sentence


def test_the_variance_of_coloured_innovations_is_known_by_fewer_degrees_of_freedom():
    """Var(mean y²) = 2·Σρ²/n over all lags (Bartlett); of an autoregression of 0.5, Σρ² = 5/3."""
    z, u = as_assumed()
    coloured = lfilter([math.sqrt(0.75)], [1.0, -0.5], 1.02 * z)
    y = normalised_innovations(coloured, u, DT_S, NOISE)
    found = innovation_check(coloured, u, DT_S, NOISE).per_sample
    excess = math.log(float(y @ y) / len(y)) / math.sqrt(2.0 * (5.0 / 3.0) / len(y))
    assert norm.isf(found.variance_p_value / 2.0) == pytest.approx(abs(excess), rel=0.05)


@pytest.mark.parametrize("frequency_hz", [0.3, 1.3, 4.1, 41.0])
def test_a_tone_is_told_as_correlation(frequency_hz):
    z, u = as_assumed()
    amplitude_deg = 0.03 if frequency_hz < 5.0 else 0.1
    tone_deg = amplitude_deg * np.sin(2.0 * np.pi * frequency_hz * np.arange(12_000) * DT_S)

    assert innovation_check(z + tone_deg, u, DT_S, NOISE).verdict == "correlated"


def test_a_filter_too_eager_is_told_so():
    """Process noise 30 times too large: the filter follows the noise, and its innovation alternates."""
    eager = KalmanNoise(30.0 * NOISE.q_angle, 30.0 * NOISE.q_bias, NOISE.r_deg2)

    check = innovation_check(*as_assumed(n=60_000), DT_S, eager)

    assert check.verdict == "correlated"
    assert check.per_block.first_correlation < 0.0
    assert "too eagerly" in check.sentence


def test_white_innovations_half_a_turn_away_are_no_surprise():
    z, u = as_assumed()
    z = (z + 360.0) % 360.0 - 180.0

    assert innovation_check(z, u, DT_S, NOISE).verdict == "consistent"


def test_a_stretch_of_a_second_says_nothing():
    check = innovation_check(*as_assumed(n=200), DT_S, NOISE)

    assert (check.verdict, check.per_block) == ("too_short", None)
    assert "2 s" in check.sentence


def test_a_sensor_without_any_noise_varies_less():
    assert innovation_check(np.zeros(2000), np.zeros(2000), DT_S, NOISE).verdict == "varies_less"
