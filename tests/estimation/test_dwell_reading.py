"""A dwell's reading, and whether its stated standard error is what readings really scatter by."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import butter, lfilter
from scipy.stats import chi2

from calrig.estimation.autoregressive import fit_autoregression
from calrig.estimation.gains import filter_uniform
from calrig.estimation.kalman import KalmanFilter
from calrig.estimation.reading import dwell_reading, reading_stderr_deg

SETTLE_S = 5.0
SEEDS = 250


def colour(white, lowpass_hz, order, rate_hz):
    """White noise through a low-pass of unit gain at 0 Hz, as a sensor's DLPF makes it."""
    if lowpass_hz is None:
        return white
    if order == 1:
        pole = math.exp(-2.0 * math.pi * lowpass_hz / rate_hz)
        return lfilter([1.0 - pole], [1.0, -pole], white)
    return lfilter(*butter(order, lowpass_hz, fs=rate_hz), white)


def dwells(rate_hz, dwell_s, lowpass_hz=None, order=1, seeds=SEEDS, noise=(0.2, 0.07)):
    """Readings of still dwells after a long settling; `noise` in elevation (°) and in rate (°/s)."""
    noise_deg, noise_dps = noise
    for seed in range(seeds):
        rng = np.random.default_rng((seed, rate_hz))
        n, dwell = round((SETTLE_S + dwell_s) * rate_hz), round(dwell_s * rate_hz)
        elevation_deg = 30.0 + colour(rng.normal(0.0, noise_deg, n), lowpass_hz, order, rate_hz)
        rate_dps = colour(rng.normal(0.0, noise_dps, n), lowpass_hz, order, rate_hz)
        filtered_deg = filter_uniform(elevation_deg, rate_dps, 1.0 / rate_hz)
        time_s = np.arange(dwell) / rate_hz
        yield dwell_reading(time_s, elevation_deg[-dwell:], rate_dps[-dwell:], filtered_deg[-dwell:])


def judge_scatter(rate_hz, dwell_s, lowpass_hz, order, scatter, seeds, **noise):
    readings = list(dwells(rate_hz, dwell_s, lowpass_hz, order, seeds, **noise))
    stated_deg = np.array([reading.reading_stderr_deg for reading in readings])
    off_deg = np.array([reading.reading_deg for reading in readings]) - 30.0

    in_stated_variances = float(off_deg @ off_deg) / np.mean(stated_deg**2)

    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], seeds)
    assert low < in_stated_variances < high
    assert stated_deg.std() / stated_deg.mean() < scatter


def test_readings_scatter_by_their_stated_standard_error():
    judge_scatter(50, 1.0, None, 1, 0.20, seeds=60)


def test_they_do_where_the_gyro_is_the_noisier_of_the_two():
    judge_scatter(50, 1.0, None, 1, 0.20, seeds=60, noise=(0.01, 1.0))


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("rate_hz", "dwell_s", "lowpass_hz", "order", "scatter"),
    [
        (50, 1.0, None, 1, 0.20),
        (200, 1.0, None, 1, 0.10),
        (200, 2.0, None, 1, 0.07),
        (1000, 10.0, None, 1, 0.03),
        (50, 10.0, 10.0, 1, 0.15),
        (200, 2.0, 20.0, 1, 0.20),
        (200, 10.0, 5.0, 1, 0.20),
        (1000, 1.0, 20.0, 1, 0.25),
        (1000, 2.0, 44.0, 2, 0.20),
    ],
)
def test_they_do_at_every_rate_and_through_every_low_pass(rate_hz, dwell_s, lowpass_hz, order, scatter):
    judge_scatter(rate_hz, dwell_s, lowpass_hz, order, scatter, seeds=SEEDS if rate_hz < 1000 else SEEDS // 3)


def test_the_naive_standard_error_would_be_many_times_too_small():
    readings = list(dwells(200, 1.0, seeds=10))

    naive = [reading.reading_std_deg / math.sqrt(reading.n_samples) for reading in readings]

    assert np.mean([reading.reading_stderr_deg for reading in readings]) > 8.0 * np.mean(naive)


@pytest.mark.statistical
def test_a_dwell_that_ends_at_its_target_still_scatters_by_no_more_than_it_says():
    """Looking five times a second and stopping at the first error that is small enough picks lucky ones."""
    rate_hz, target_deg, seeds, ended = 100, 0.015, 150, []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        n = round((SETTLE_S + 6.0) * rate_hz)
        elevation_deg, rate_dps = rng.normal(0.0, 0.2, n), rng.normal(0.0, 0.07, n)
        filtered_deg = filter_uniform(elevation_deg, rate_dps, 1.0 / rate_hz)
        start = round(SETTLE_S * rate_hz)
        for end in range(start + rate_hz // 2, n, rate_hz // 5):
            part = slice(start, end)
            time_s = np.arange(end - start) / rate_hz
            error_deg = reading_stderr_deg(time_s, elevation_deg[part], rate_dps[part], filtered_deg[part])
            if error_deg <= target_deg:
                ended.append((filtered_deg[part].mean(), error_deg))
                break
    off_deg, stated_deg = np.array(ended).T

    assert len(ended) == seeds
    assert math.sqrt(np.mean(off_deg**2)) < 1.15 * math.sqrt(np.mean(stated_deg**2))


def test_a_reading_across_half_a_turn():
    """A unit on its back: elevations on both sides of ±180° are one angle, whatever turn the filter is on."""
    rng = np.random.default_rng(4)
    time_s = np.arange(2000) * 0.005
    noise_deg = rng.normal(0.0, 0.3, 2000)
    rate_dps = rng.normal(0.0, 0.07, 2000)
    upright, flipped = (
        dwell_reading(time_s, elevation, rate_dps, KalmanFilter().run(time_s, elevation, rate_dps))
        for elevation in (noise_deg, (noise_deg + 360.0) % 360.0 - 180.0)
    )

    assert abs(flipped.reading_deg) > 179.9
    assert -180.0 < flipped.reading_deg <= 180.0
    assert flipped.reading_stderr_deg == pytest.approx(upright.reading_stderr_deg, rel=1e-6)


def test_what_a_few_samples_cannot_tell_is_none():
    one = dwell_reading(np.zeros(1), np.ones(1), np.zeros(1), np.ones(1))
    assert (one.reading_deg, one.reading_std_deg, one.reading_stderr_deg, one.n_samples) == (
        1.0,
        None,
        None,
        1,
    )

    few = dwell_reading(np.arange(7) * 0.01, np.ones(7), np.zeros(7), np.arange(7.0))
    assert few.reading_stderr_deg is None
    assert few.reading_std_deg == pytest.approx(np.std(np.arange(7.0), ddof=1))


def test_inputs_without_any_noise_give_a_reading_without_error():
    still = dwell_reading(np.arange(100) * 0.01, np.full(100, 5.0), np.zeros(100), np.full(100, 5.0))
    assert (still.reading_deg, still.reading_stderr_deg) == (5.0, 0.0)


@pytest.mark.parametrize("lengths", [(0, 0, 0, 0), (9, 9, 9, 10), (9, 8, 9, 9)])
def test_a_dwell_without_samples_or_with_some_missing_is_refused(lengths):
    with pytest.raises(ValueError, match="a dwell needs samples"):
        dwell_reading(*(np.zeros(n) for n in lengths))


@pytest.mark.parametrize("phi", [-0.5, 0.0, 0.6, 0.9])
def test_the_spectrum_of_a_known_process_is_found(phi):
    """An AR(1) process x = φ·x + e has long-run variance 1/(1 − φ)²."""
    rng = np.random.default_rng(7)
    x = lfilter([1.0], [1.0, -phi], rng.normal(size=20_000))[1000:]

    long_run = fit_autoregression(x).density(np.zeros(1))[0]

    assert math.sqrt(long_run) == pytest.approx(1.0 / (1.0 - phi), rel=0.08)


@pytest.mark.parametrize(("phi", "order"), [(0.0, 0), (0.8, 1)])
def test_the_variance_is_enlarged_for_what_was_estimated_from_the_same_samples(phi, order):
    """By hand: two parameters of the line and one for each order; n_eff/(n_eff − 2) for the line itself."""
    n = 60
    x = lfilter([1.0], [1.0, -phi], np.random.default_rng(3).standard_normal(n + 200))[200:]
    found = fit_autoregression(x)
    assert len(found.coefficients) == order + 1
    a1 = found.coefficients[1] if order else 0.0
    t = np.arange(n)
    residual = x - np.polyval(np.polyfit(t, x, 1), t)
    innovation = residual @ residual * (1.0 - a1**2) / (n - 2 - order)
    independent = min(max(n * (1.0 + a1) / (1.0 - a1), 4.0), n)
    assert found.variance == pytest.approx(innovation * independent / (independent - 2.0))


def test_a_perfectly_predictable_channel_does_not_break_the_spectrum():
    square = np.tile([0.01, -0.01], 200)
    assert fit_autoregression(square).density(np.zeros(1))[0] < 1e-6


@pytest.mark.statistical
@pytest.mark.parametrize("filter_s", [0.02, 0.1])
def test_an_angle_filtered_on_the_board_scatters_by_its_stated_standard_error(filter_s):
    """Its filter is short against the dwell of 4 s; of a slow one the dwell cannot tell."""
    rate_hz, n = 50, 200
    pole = math.exp(-1 / (filter_s * rate_hz))
    readings = []
    for seed in range(SEEDS):
        white = np.random.default_rng(seed).normal(0.0, 0.2, 3 * n)
        angle_deg = 30.0 + lfilter([1.0 - pole], [1.0, -pole], white)[-n:]
        readings.append(dwell_reading(np.arange(n) / rate_hz, angle_deg, None, angle_deg))
    stated_deg = np.array([reading.reading_stderr_deg for reading in readings])
    scatter_deg = np.std([reading.reading_deg for reading in readings], ddof=1)
    assert np.sqrt(np.mean(stated_deg**2)) == pytest.approx(scatter_deg, rel=0.2)
