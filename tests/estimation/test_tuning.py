"""Constants from Allan coefficients: they are those of the data, and no others do better on them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from calrig.estimation.gains import filter_uniform, gain_schedule, samples_to_steady_state, steady_state_gain
from calrig.estimation.kalman import KalmanFilter, KalmanNoise
from calrig.estimation.tuning import BIAS_HORIZON_S, midpoint_rate_dps, tuned_noise

RATE_HZ, N = 200.0, 200_000
WHITE = {"white_elevation_deg_sqrt_s": 0.016, "white_gyro_dps_sqrt_s": 0.0035, "rate_hz": RATE_HZ}
WALK = 0.002


def rms_error_deg(noise, z, u):
    """Of the filter where the true angle is 0, start left out."""
    settled = filter_uniform(z, u, 1.0 / RATE_HZ, noise)[20_000:]
    return math.sqrt(float(np.mean(settled**2)))


def sensor(seed=0, low_pass=0.0):
    """Elevation and rate with the coefficients above; `low_pass` makes neighbouring elevations alike."""
    rng = np.random.default_rng(seed)
    white_z, white_u, steps = rng.standard_normal((3, N))
    z = WHITE["white_elevation_deg_sqrt_s"] * math.sqrt(RATE_HZ) * white_z
    bias = WALK / math.sqrt(RATE_HZ) * np.cumsum(steps)
    u = bias + WHITE["white_gyro_dps_sqrt_s"] * math.sqrt(RATE_HZ) * white_u
    return lfilter([1.0 - low_pass], [1.0, -low_pass], z), u


def test_the_constants_are_the_densities_of_the_noise():
    noise = tuned_noise(**WHITE, random_walk_gyro_dps_per_sqrt_s=WALK)

    assert noise.q_angle == pytest.approx(0.0035**2)
    assert noise.q_bias == pytest.approx(0.002**2)
    assert noise.r_deg2 / RATE_HZ == pytest.approx(0.016**2)


@pytest.mark.parametrize("low_pass", [0.0, 0.9])
def test_the_filter_states_its_own_error(low_pass):
    """R from the density at low frequency is right also where the chip's low-pass correlates the samples."""
    noise = tuned_noise(**WHITE, random_walk_gyro_dps_per_sqrt_s=WALK)

    errors = [rms_error_deg(noise, *sensor(seed, low_pass)) for seed in range(4)]

    stated = math.sqrt(float(steady_state_gain(noise, 1.0 / RATE_HZ).covariance[0, 0]))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(stated, rel=0.05)


@pytest.mark.parametrize("constant", ["q_angle", "q_bias", "r_deg2"])
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_no_other_constants_do_better(constant, factor):
    right = tuned_noise(**WHITE, random_walk_gyro_dps_per_sqrt_s=WALK)
    constants = {name: getattr(right, name) for name in ("q_angle", "q_bias", "r_deg2")}
    wrong = KalmanNoise(**constants | {constant: factor * constants[constant]})

    for seed in range(3):
        z, u = sensor(seed)
        assert rms_error_deg(right, z, u) < rms_error_deg(wrong, z, u)


@given(flicker=st.floats(1e-3, 0.1), white=st.floats(1e-3, 0.1))
def test_flicker_becomes_the_walk_that_meets_the_floor_where_white_noise_does(flicker, white):
    coefficients = WHITE | {"white_gyro_dps_sqrt_s": white}
    noise = tuned_noise(**coefficients, flicker_gyro_dps=flicker)

    floor = 0.664 * flicker
    tau_s = (white / floor) ** 2
    walk_there = math.sqrt(noise.q_bias * tau_s / 3.0)
    if tau_s <= BIAS_HORIZON_S:
        assert walk_there == pytest.approx(floor, rel=2e-3)
    else:
        assert noise.q_bias == tuned_noise(**coefficients).q_bias


def test_a_bias_never_seen_to_wander_is_trusted_only_so_long():
    noise = tuned_noise(**WHITE)

    walk_at_horizon = math.sqrt(noise.q_bias * BIAS_HORIZON_S / 3.0)
    assert walk_at_horizon == pytest.approx(0.0035 / math.sqrt(BIAS_HORIZON_S))


def test_a_bias_that_drifts_with_the_warming_chip_leaves_a_hundredth_of_a_degree():
    """0.01 °/s a minute, without noise: what the constants alone make of it."""
    rate_dps = np.arange(60_000) / RATE_HZ * 0.01 / 60.0

    filtered = filter_uniform(np.zeros(60_000), rate_dps, 1.0 / RATE_HZ, tuned_noise(**WHITE))

    assert 0.0 < filtered[-1] < 0.02


def test_an_uncertain_scale_enters_as_the_walk_that_moves_make_of_it():
    """1 % of 10° every 4 s: 0.1° at a time."""
    certain = tuned_noise(**WHITE)
    uncertain = tuned_noise(**WHITE, gyro_scale_std=0.01, turning_deg_per_sqrt_s=5.0)

    assert uncertain.q_angle - certain.q_angle == pytest.approx(0.1**2 / 4.0)
    assert (uncertain.q_bias, uncertain.r_deg2) == (certain.q_bias, certain.r_deg2)


@pytest.mark.parametrize(
    "wrong",
    [
        {"white_elevation_deg_sqrt_s": 0.0},
        {"white_gyro_dps_sqrt_s": -1.0},
        {"rate_hz": math.inf},
        {"flicker_gyro_dps": math.nan},
        {"random_walk_gyro_dps_per_sqrt_s": -1e-3},
    ],
)
def test_a_coefficient_that_means_nothing_is_refused(wrong):
    with pytest.raises(ValueError, match="no filter can be tuned"):
        tuned_noise(**WHITE | wrong)


def test_rates_between_samples_add_up_to_the_angle_of_a_move():
    """A rate of straight lines: every step gets its own mean, so that no sample on the way is ahead."""
    time_s = np.arange(400) / RATE_HZ
    rate_dps = np.interp(time_s, [0.25, 0.5, 1.0, 1.25], [0.0, 20.0, 20.0, 0.0])
    turned_deg = np.concatenate([[0.0], np.cumsum((rate_dps[1:] + rate_dps[:-1]) / 2.0 / RATE_HZ)])

    midpoint = midpoint_rate_dps(rate_dps)

    np.testing.assert_allclose(np.cumsum(midpoint) / RATE_HZ, turned_deg, atol=1e-12)
    assert np.abs(np.cumsum(rate_dps) / RATE_HZ - turned_deg).max() == pytest.approx(0.05)  # without


@settings(max_examples=25, deadline=None)
@given(
    q_angle=st.floats(1e-5, 0.1),
    q_bias=st.floats(1e-6, 0.1),
    r_deg2=st.floats(1e-3, 1.0),
    dt_s=st.sampled_from([0.001, 0.005, 0.02]),
)
def test_the_schedule_turns_the_filter_into_two_lines_of_firmware(q_angle, q_bias, r_deg2, dt_s):
    noise = KalmanNoise(q_angle, q_bias, r_deg2)
    z, u = np.random.default_rng(0).normal(0.0, 1.0, (2, 3000))
    k_angle, k_bias = gain_schedule(noise, dt_s, 3000)

    angle, bias, fixed = 0.0, 0.0, []
    for n in range(3000):
        predicted = angle + dt_s * (u[n] - bias) if n else 0.0
        angle = predicted + k_angle[n] * (z[n] - predicted)
        bias += k_bias[n] * (z[n] - predicted)
        fixed.append(angle)

    np.testing.assert_allclose(fixed, KalmanFilter(noise).run(np.arange(3000) * dt_s, z, u), atol=1e-6)


@pytest.mark.parametrize("noise", [KalmanNoise(), tuned_noise(**WHITE)])
def test_the_start_is_over_when_both_gains_stay_within_a_hundredth(noise):
    samples = samples_to_steady_state(noise, 0.005)

    steady = steady_state_gain(noise, 0.005)
    gains = gain_schedule(noise, 0.005, 3 * samples)
    off = np.maximum(np.abs(gains[0] / steady.k_angle - 1.0), np.abs(gains[1] / steady.k_bias - 1.0))
    assert off[samples - 1] > 0.01
    assert off[samples:].max() <= 0.01


def test_a_start_that_never_ends_has_no_length():
    assert samples_to_steady_state(KalmanNoise(q_bias=0.0), 0.005) is None
    assert samples_to_steady_state(tuned_noise(**WHITE), 0.005, at_most_s=5.0) is None
