"""Welch's spectrum and its slope, on noise of a known power law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch

from calrig.noise.spectrum import psd_of, psd_slope

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
