"""At uniform dt: the closed-form gain against a Riccati solver, the fast filter against the recursion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from calrig.estimation.gains import filter_uniform, steady_state_gain
from calrig.estimation.kalman import KalmanFilter, KalmanNoise


def sequential(elevation_deg, rate_dps, dt_s, noise=None):
    kalman = KalmanFilter(noise)
    pairs = zip(elevation_deg.tolist(), rate_dps.tolist(), strict=True)
    return np.array([kalman.update(elevation, rate, dt_s) for elevation, rate in pairs])


@settings(max_examples=100, deadline=None)
@given(
    q_angle=st.floats(1e-4, 0.1),
    q_bias=st.floats(1e-4, 0.1),
    r_deg2=st.floats(1e-3, 1.0),
    dt_s=st.floats(1e-3, 0.5),
)
def test_closed_form_gain_solves_the_riccati_equation(q_angle, q_bias, r_deg2, dt_s):
    gain = steady_state_gain(KalmanNoise(q_angle, q_bias, r_deg2), dt_s)

    transition = np.array([[1.0, -dt_s], [0.0, 1.0]])
    prior = solve_discrete_are(
        transition.T, np.array([[1.0], [0.0]]), np.diag([q_angle, q_bias]) * dt_s, np.array([[r_deg2]])
    )
    expected = prior[:, 0] / (prior[0, 0] + r_deg2)
    np.testing.assert_allclose([gain.k_angle, gain.k_bias], expected, rtol=1e-8)
    np.testing.assert_allclose(gain.covariance, prior - np.outer(expected, prior[0]), rtol=1e-6)


def test_gain_without_bias_noise_is_that_of_a_random_walk():
    """With q_bias 0 the bias is learnt once and for all, and the angle's gain solves k²/(1 − k) = q·dt/R."""
    gain = steady_state_gain(KalmanNoise(q_bias=0.0), 0.005)

    assert gain.k_bias == 0.0
    assert gain.k_angle**2 / (1.0 - gain.k_angle) == pytest.approx(0.001 * 0.005 / 0.03, rel=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rate_hz=st.sampled_from([10.0, 50.0, 200.0, 1000.0]),
    turn_dps=st.floats(-90.0, 90.0),
    noise_deg=st.floats(0.01, 5.0),
)
def test_whole_array_equals_the_recursion(seed, rate_hz, turn_dps, noise_deg):
    rng = np.random.default_rng(seed)
    n = 12_000
    true_deg = turn_dps * np.arange(n) / rate_hz
    elevation_deg = (true_deg + rng.normal(0.0, noise_deg, n) + 180.0) % 360.0 - 180.0
    rate_dps = turn_dps + 1.5 + rng.normal(0.0, 0.1, n)

    filtered = filter_uniform(elevation_deg, rate_dps, 1.0 / rate_hz)

    np.testing.assert_allclose(
        filtered, sequential(elevation_deg, rate_dps, 1.0 / rate_hz), rtol=0.0, atol=1e-9
    )


def test_whole_array_equals_the_recursion_where_elevation_leaps_half_a_turn():
    """Elevations all around the circle: innovations beyond 180° that only the recursion can place."""
    rng = np.random.default_rng(5)
    elevation_deg = rng.uniform(-180.0, 180.0, 6000)
    rate_dps = rng.normal(0.0, 50.0, 6000)

    filtered = filter_uniform(elevation_deg, rate_dps, 0.005)

    assert filtered.tolist() == sequential(elevation_deg, rate_dps, 0.005).tolist()


@pytest.mark.parametrize("n", [0, 1, 2, 511, 512, 513])
def test_short_logs_are_the_recursion_itself(n):
    rng = np.random.default_rng(n)
    elevation_deg, rate_dps = rng.normal(0.0, 1.0, (2, n))

    filtered = filter_uniform(elevation_deg, rate_dps, 0.01)

    assert filtered.tolist() == sequential(elevation_deg, rate_dps, 0.01).tolist()


@pytest.mark.parametrize("at", [0, 5, 9000])
def test_a_sample_that_is_not_finite_is_refused_wherever_it_is(at):
    elevation_deg = np.zeros(10_000)
    elevation_deg[at] = np.nan

    with pytest.raises(ValueError, match="not finite"):
        filter_uniform(elevation_deg, np.zeros(10_000), 0.005)


@pytest.mark.parametrize("dt_s", [0.0, -0.005, float("nan")])
def test_an_interval_that_is_none_is_refused(dt_s):
    with pytest.raises(ValueError, match="sampling interval"):
        filter_uniform(np.zeros(3), np.zeros(3), dt_s)


def test_frequency_response_is_what_the_running_filter_does_to_a_sine():
    gain = steady_state_gain(KalmanNoise(), 0.005)
    omega = np.array([2.0 * np.pi * 0.5 * 0.005])
    n = np.arange(12_000)
    sine = np.exp(1j * omega[0] * n)
    whole_cycles = slice(8000, 12_000)

    for axis, response in enumerate(gain.response(omega)):
        inputs = [np.zeros(12_000), np.zeros(12_000)]
        inputs[axis] = sine.real
        out = filter_uniform(inputs[0], inputs[1], 0.005)[whole_cycles]
        measured = 2.0 * np.mean(out * np.conj(sine[whole_cycles]))
        assert measured == pytest.approx(response[0], rel=1e-3)
