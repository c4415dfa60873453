"""The filter against independent implementations, at uniform dt, across ±180°, and on input it refuses."""

from __future__ import annotations

import math

import filterpy.kalman
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from calrig.estimation.gains import filter_uniform, steady_state_gain
from calrig.estimation.kalman import INITIAL_BIAS_VARIANCE, KalmanFilter, KalmanNoise

NOISES = st.builds(
    KalmanNoise, q_angle=st.floats(1e-5, 1.0), q_bias=st.floats(0.0, 1.0), r_deg2=st.floats(1e-3, 10.0)
)
SAMPLES = st.lists(
    st.tuples(st.floats(-80.0, 80.0), st.floats(-300.0, 300.0), st.floats(1e-4, 0.5)), min_size=2, max_size=80
)


DIFFUSE_DEG2 = 1e9
"""Variance of an angle of which a gap has left nothing known."""


def filterpy_angles(samples, noise, gap_s=math.inf):
    """Filter the samples by filterpy's matrices, started the same way; across a gap the angle is diffuse."""
    oracle = filterpy.kalman.KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
    oracle.x = np.array([[samples[0][0]], [0.0]])
    oracle.P = np.diag([noise.r_deg2, INITIAL_BIAS_VARIANCE])
    oracle.H = np.array([[1.0, 0.0]])
    oracle.R = np.array([[noise.r_deg2]])
    angles = [samples[0][0]]
    for elevation_deg, rate_dps, dt_s in samples[1:]:
        oracle.predict(
            u=np.array([[rate_dps]]),
            B=np.array([[dt_s], [0.0]]),
            F=np.array([[1.0, -dt_s], [0.0, 1.0]]),
            Q=np.diag([noise.q_angle if dt_s <= gap_s else DIFFUSE_DEG2, noise.q_bias]) * dt_s,
        )
        # filterpy knows no turns: it is told the elevation on the turn nearest to its prediction
        turns = round((oracle.x[0, 0] - elevation_deg) / 360.0)
        oracle.update(np.array([[elevation_deg + 360.0 * turns]]))
        angles.append(float(oracle.x[0, 0]))
    return angles, oracle


@settings(max_examples=150, deadline=None)
@given(samples=SAMPLES, noise=NOISES)
def test_filter_equals_filterpy_on_uneven_time(samples, noise):
    kalman = KalmanFilter(noise)
    angles = [kalman.update(*sample) for sample in samples]

    expected, oracle = filterpy_angles(samples, noise)

    np.testing.assert_allclose(angles, expected, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(kalman.covariance, oracle.P, rtol=1e-9, atol=1e-12)
    assert kalman.bias_dps == pytest.approx(oracle.x[1, 0], rel=1e-9, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(samples=SAMPLES, cut=st.integers(0, 80))
def test_blocks_give_what_single_samples_give(samples, cut):
    elevation_deg, rate_dps, dt_s = np.array(samples).T
    time_s = np.cumsum(dt_s)
    single = KalmanFilter()
    steps = np.diff(time_s, prepend=0.0)

    blocks = KalmanFilter()
    filtered = np.concatenate(
        [
            blocks.run(time_s[part], elevation_deg[part], rate_dps[part])
            for part in (slice(0, cut), slice(cut, None))
        ]
    )

    assert filtered.tolist() == [
        single.update(*s) for s in zip(elevation_deg.tolist(), rate_dps.tolist(), steps.tolist(), strict=True)
    ]


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_angle_goes_past_half_a_turn_without_a_jump(sense):
    """Three turns at 90 °/s: the accelerometer jumps six times, the filter never."""
    time_s = np.arange(2400) * 0.005
    true_deg = sense * 90.0 * time_s
    elevation_deg = np.degrees(np.arctan2(np.sin(np.radians(true_deg)), np.cos(np.radians(true_deg))))

    filtered_deg = KalmanFilter().run(time_s, elevation_deg, np.full(2400, sense * 90.0))

    np.testing.assert_allclose(filtered_deg, true_deg, atol=1e-9)


def test_noise_about_half_a_turn_is_averaged_on_one_side():
    rng = np.random.default_rng(1)
    elevation_deg = 180.0 + rng.normal(0.0, 0.3, 2000)
    elevation_deg[elevation_deg > 180.0] -= 360.0

    filtered_deg = KalmanFilter().run(np.arange(2000) * 0.005, elevation_deg, np.zeros(2000))

    off_half_a_turn = np.abs(filtered_deg[400:]) - 180.0
    assert np.ptp(filtered_deg[400:]) < 1.0
    assert np.abs(off_half_a_turn).max() < 0.3


def test_one_second_of_settling_forgets_a_data_sheets_worst_bias():
    kalman = KalmanFilter()
    kalman.run(np.arange(201) * 0.005, np.zeros(201), np.full(201, 20.0))

    assert kalman.bias_dps == pytest.approx(20.0, abs=0.06)


def test_after_a_gap_it_takes_the_angle_anew_and_keeps_the_bias():
    """A table that turned by 60° while no sample came, its gyro off by 1.4 °/s."""
    before_s, after_s = np.arange(2000) * 0.005, 12.0 + np.arange(200) * 0.005
    plain, kalman = KalmanFilter(), KalmanFilter(gap_s=0.04)
    for one in (plain, kalman):
        one.run(before_s, np.zeros(2000), np.full(2000, 1.4))
    filtered_deg = kalman.run(after_s, np.full(200, 60.0), np.full(200, 1.4))

    assert np.abs(filtered_deg - 60.0).max() < 0.01
    assert kalman.bias_dps == pytest.approx(1.4, abs=0.01)
    assert np.abs(plain.run(after_s, np.full(200, 60.0), np.full(200, 1.4)) - 60.0).max() > 10.0


@settings(max_examples=50, deadline=None)
@given(before=SAMPLES, after=SAMPLES, noise=NOISES, lost_s=st.floats(1.0, 60.0))
def test_after_a_gap_the_covariance_is_that_of_filterpy(before, after, noise, lost_s):
    """The bias drifts as long as the gap lasts: a filter that forgets this trusts its bias too much."""
    samples = [*before, (*after[0][:2], lost_s), *after[1:]]
    kalman = KalmanFilter(noise, gap_s=0.9)
    for sample in samples:
        kalman.update(*sample)

    _, oracle = filterpy_angles(samples, noise, gap_s=0.9)

    np.testing.assert_allclose(kalman.covariance, oracle.P, rtol=1e-5, atol=1e-6)
    assert kalman.bias_dps == pytest.approx(oracle.x[1, 0], rel=1e-4, abs=1e-3)


def test_after_a_gap_the_angle_stays_on_its_turn():
    kalman = KalmanFilter(gap_s=0.04)
    kalman.run(np.arange(3) * 0.01, [178.0, 179.0, 180.0], np.full(3, 100.0))

    assert kalman.run([1.0], [-178.0], [0.0])[0] == pytest.approx(182.0)


@pytest.mark.parametrize(
    "sample", [(math.nan, 0.0, 0.01), (0.0, math.nan, 0.01), (math.inf, 0.0, 0.01), (0.0, 0.0, 0.0)]
)
def test_a_sample_that_means_nothing_is_refused_and_changes_nothing(sample):
    kalman = KalmanFilter()
    kalman.update(10.0, 0.0, 0.0)
    kalman.update(10.1, 0.2, 0.01)
    before = (kalman.angle_deg, kalman.bias_dps, kalman.covariance.tolist())

    with pytest.raises(ValueError, match=r"not finite|go forward"):
        kalman.update(*sample)

    assert (kalman.angle_deg, kalman.bias_dps, kalman.covariance.tolist()) == before


def test_the_first_sample_is_refused_too_where_it_is_not_finite():
    with pytest.raises(ValueError, match="not finite"):
        KalmanFilter().update(math.nan, 0.0, 0.01)


@pytest.mark.parametrize(
    ("time_s", "elevation_deg", "rate_dps", "complaint"),
    [
        ([1.0, 1.1], [0.0, math.nan], [0.0, 0.0], "sample 1 of the block: elevation"),
        ([1.0, 1.1], [0.0, 0.0], [math.inf, 0.0], "sample 0 of the block: rate"),
        ([1.0, 0.9], [0.0, 0.0], [0.0, 0.0], "sample 1 of the block, at 0.9 s"),
        ([0.5, 1.1], [0.0, 0.0], [0.0, 0.0], "sample 0 of the block, at 0.5 s"),
        ([1.0, 1.1], [0.0], [0.0, 0.0], "elevations"),
    ],
)
def test_a_bad_block_is_refused_whole_and_the_filter_goes_on(time_s, elevation_deg, rate_dps, complaint):
    kalman = KalmanFilter()
    kalman.run([0.4, 0.5], [1.0, 1.0], [0.0, 0.0])

    with pytest.raises(ValueError, match=complaint):
        kalman.run(time_s, elevation_deg, rate_dps)

    assert kalman.run([0.6], [1.0], [0.0]).tolist() == [1.0]


@pytest.mark.parametrize("noise", [{"q_angle": 0.0}, {"q_bias": -1.0}, {"r_deg2": math.nan}])
def test_noise_that_no_filter_has_is_refused(noise):
    with pytest.raises(ValueError, match="must be"):
        KalmanNoise(**noise)


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
