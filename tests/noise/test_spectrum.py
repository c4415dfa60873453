"""Welch's spectrum and its slope, on noise of a known power law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch
from scipy.stats import linregress

from calrig.noise.spectrum import Psd, psd_of, psd_slope

RATE_HZ = 100.0


def power_law(seed: int, exponent: float, n: int = 40_000) -> np.ndarray:
    """Noise whose density falls as f^-exponent, shaped in frequency."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(2 * n))
    f = np.fft.rfftfreq(2 * n)
    f[0] = f[1]
    return np.fft.irfft(spectrum * f ** (-exponent / 2.0))[:n]


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_the_slope_is_the_power_laws_within_its_own_standard_error(exponent):
    found = [psd_slope(psd_of(power_law(seed, exponent), RATE_HZ, [slice(0, 40_000)])) for seed in range(30)]
    off = np.array([(told.slope + exponent) / told.std for told in found])
    assert abs(off.mean()) < 4.0 / np.sqrt(len(off))
    assert 0.6 < off.std() < 1.5


def test_the_density_of_white_noise_is_twice_its_variance_over_the_rate():
    x = np.random.default_rng(1).normal(0.0, 0.3, 100_000)
    psd = psd_of(x, RATE_HZ, [slice(0, len(x))])
    assert psd.density[2:-2].mean() == pytest.approx(2 * 0.3**2 / RATE_HZ, rel=0.02)


def test_one_segment_gives_what_scipy_gives_and_several_their_average():
    x = np.random.default_rng(2).standard_normal(30_000)
    whole = psd_of(x, RATE_HZ, [slice(0, 30_000)])
    window = 2 * (len(whole.density) - 1)
    assert whole.density == pytest.approx(welch(x, RATE_HZ, nperseg=window)[1])
    parts = psd_of(x, RATE_HZ, [slice(0, 15_000), slice(15_000, 30_000)])
    window = 2 * (len(parts.density) - 1)
    halves = [welch(part, RATE_HZ, nperseg=window)[1] for part in (x[:15_000], x[15_000:])]
    assert parts.density == pytest.approx(np.mean(halves, axis=0))


def test_a_line_does_not_bend_the_slope():
    t = np.arange(60_000) / RATE_HZ
    x = np.random.default_rng(3).standard_normal(len(t)) + 2.0 * np.sin(2 * np.pi * 7.3 * t)
    told = psd_slope(psd_of(x, RATE_HZ, [slice(0, len(t))]))
    assert abs(told.slope) < 4 * told.std


def test_a_log_too_short_has_no_spectrum():
    psd = psd_of(np.arange(10.0), RATE_HZ, [slice(0, 10)])
    assert (len(psd.density), psd_slope(psd), psd.averages) == (0, None, 0)


def test_no_piece_reaches_over_a_gap():
    x = np.random.default_rng(4).standard_normal(40_000)
    x[20_000:] += 1000.0
    psd = psd_of(x, RATE_HZ, [slice(0, 20_000), slice(20_000, 40_000)])
    assert psd.density.max() < 10.0 * np.median(psd.density)


def test_a_log_in_hundreds_of_short_pieces_has_the_spectrum_of_all_of_them():
    x = np.random.default_rng(5).standard_normal(51 * 378)
    psd = psd_of(x, RATE_HZ, [slice(a, a + 51) for a in range(0, len(x), 51)])
    assert psd.averages >= 378
    assert psd.density[3:-1] == pytest.approx(2.0 / RATE_HZ, rel=0.25)


def test_a_strong_line_at_low_frequency_does_not_bend_the_slope_once_it_is_known():
    t = np.arange(60_000) / RATE_HZ
    x = np.random.default_rng(6).standard_normal(len(t)) + 3.0 * np.sin(2 * np.pi * 0.31 * t)
    psd = psd_of(x, RATE_HZ, [slice(0, len(t))])
    assert abs(psd_slope(psd).slope) > 0.05
    assert abs(psd_slope(psd, lines_hz=[0.31]).slope) < 0.05


def test_a_spectrum_that_bends_gives_a_slope_with_a_larger_error_and_the_band_it_is_of():
    rng = np.random.default_rng(7)
    white = rng.standard_normal(60_000)
    straight, bent = (
        psd_slope(psd_of(x, RATE_HZ, [slice(0, len(x))]))
        for x in (white, white + 0.05 * np.cumsum(rng.standard_normal(60_000)))
    )
    assert -2.0 < bent.slope < 0.0
    assert bent.std > 5.0 * straight.std
    assert (bent.low_hz, bent.high_hz) == pytest.approx((4 * RATE_HZ / 4096, 0.8 * RATE_HZ / 2), rel=0.01)


def test_the_slope_of_one_piece_of_white_noise_is_level_on_average():
    """Groups of one bin and of many have logarithms of different bias; neither bends the line."""
    rng = np.random.default_rng(8)
    frequency_hz = np.arange(257.0)
    slopes = [psd_slope(Psd(frequency_hz, rng.exponential(size=257), 1)).slope for _ in range(200)]
    assert abs(np.mean(slopes)) < 4.0 * np.std(slopes) / np.sqrt(200)


def test_the_standard_error_of_the_slope_of_a_wavy_spectrum_is_that_of_least_squares():
    """Each quarter octave lies off the line by far more than it scatters: all of them count alike."""
    frequency_hz = np.arange(513.0)
    group = np.floor(4.0 * np.log2(np.maximum(frequency_hz, 1.0) / 4.0) + 1e-9).astype(int)
    height = np.random.default_rng(9).normal(0.0, 0.5, group.max() + 1)
    used = (frequency_hz >= 4.0) & (frequency_hz <= 0.8 * 512.0)
    found = psd_slope(Psd(frequency_hz, np.exp(height[np.maximum(group, 0)]), 10**9))
    groups = np.unique(group[used])
    middle = [np.median(np.log(frequency_hz[used & (group == one)])) for one in groups]
    line = linregress(middle, height[groups])
    assert found.slope == pytest.approx(line.slope, rel=1e-3)
    assert found.std == pytest.approx(line.stderr, rel=1e-3)
