"""Welch's density and the slope that is read from it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch

from calrig.noise.spectrum import LONGEST, psd_of, psd_slope

RATE_HZ = 100.0


def power_law(exponent: float, n: int, seed: int) -> np.ndarray:
    """Noise whose density goes as f^exponent, a stretch of twice as much, so that its ends do not meet."""
    white = np.fft.rfft(np.random.default_rng(seed).normal(size=2 * n))
    frequency = np.arange(len(white), dtype=float)
    frequency[0] = 1.0
    return np.fft.irfft(white * frequency ** (exponent / 2.0), 2 * n)[:n]


def whole(x: np.ndarray) -> tuple[slice, ...]:
    return (slice(0, len(x)),)


def test_a_long_log_has_the_density_that_scipy_gives_in_one_go() -> None:
    x = power_law(-1.0, 1_200_777, seed=1)
    found = psd_of(x, RATE_HZ, whole(x))
    frequency_hz, density = welch(x, fs=RATE_HZ, nperseg=LONGEST)
    np.testing.assert_allclose(found.frequency_hz, frequency_hz)
    np.testing.assert_allclose(found.density, density, rtol=1e-12)


def test_white_noise_of_half_a_milli_g_per_root_hertz_reads_so() -> None:
    x = 0.5e-3 * np.sqrt(RATE_HZ / 2.0) * np.random.default_rng(2).normal(size=60_000)
    found = psd_of(x, RATE_HZ, whole(x))
    assert np.sqrt(np.mean(found.density[4:])) == pytest.approx(0.5e-3, rel=0.02)


def test_no_piece_reaches_over_a_gap() -> None:
    """A step between two segments would be brown noise to a piece that holds both."""
    x = np.random.default_rng(3).normal(size=40_000)
    x[20_000:] += 1000.0
    found = psd_of(x, RATE_HZ, (slice(0, 20_000), slice(20_000, 40_000)))
    assert found.density.max() < 10.0 * np.median(found.density)


def test_many_short_segments_are_pooled() -> None:
    x = np.random.default_rng(4).normal(size=51 * 378)
    found = psd_of(x, RATE_HZ, [slice(a, a + 51) for a in range(0, len(x), 51)])
    assert found.averages >= 378
    np.testing.assert_allclose(found.density[3:-1], 2.0 / RATE_HZ, rtol=0.25)


@pytest.mark.parametrize("n", [0, 1, 15])
def test_a_log_too_short_for_a_piece_has_no_density_and_no_slope(n: int) -> None:
    found = psd_of(np.arange(float(n)), RATE_HZ, (slice(0, n),))
    assert found.averages == 0
    assert psd_slope(found) is None


@pytest.mark.parametrize("exponent", [0.0, -1.0, -2.0])
@pytest.mark.parametrize("n", [2_000, 60_000])
def test_the_slope_is_the_exponent_within_its_standard_error(exponent: float, n: int) -> None:
    scores = []
    for seed in range(40):
        x = power_law(exponent, n, seed)
        found = psd_slope(psd_of(x, RATE_HZ, whole(x)))
        assert found is not None
        scores.append((found.slope - exponent) / found.std)
    assert np.mean(np.abs(scores) < 2.0) >= 0.85
    assert abs(np.mean(scores)) < 0.6


def test_strong_lines_do_not_tilt_it() -> None:
    x = np.random.default_rng(5).normal(size=60_000)
    t = np.arange(len(x)) / RATE_HZ
    x += sum(3.0 * np.sin(2.0 * np.pi * f * t) for f in (0.31, 7.3, 20.1))
    psd = psd_of(x, RATE_HZ, whole(x))
    found = psd_slope(psd, lines_hz=(0.31, 7.3, 20.1))
    assert found is not None
    assert abs(found.slope) < 0.05


def test_where_the_density_bends_the_error_says_that_it_is_no_power_law() -> None:
    r = np.random.default_rng(6)
    x = r.normal(size=60_000) + 0.05 * np.cumsum(r.normal(size=60_000))
    found = psd_slope(psd_of(x, RATE_HZ, whole(x)))
    assert found is not None
    assert -2.0 < found.slope < 0.0
    assert found.std > 0.05


def test_it_says_over_which_frequencies_it_was_fitted() -> None:
    x = np.random.default_rng(7).normal(size=60_000)
    psd = psd_of(x, RATE_HZ, whole(x))
    found = psd_slope(psd)
    assert found is not None
    assert found.low_hz == pytest.approx(4.0 * psd.frequency_hz[1])
    assert found.high_hz == pytest.approx(0.8 * RATE_HZ / 2.0, rel=0.01)
