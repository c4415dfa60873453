"""The spectral window of some angles: which two periods these angles show as one.

A wave of frequency f, taken at angles θ alone, is that of f ± p wherever |Σ exp(2πi·p·θ)|/n is near 1
(Deeming, Astrophysics and Space Science 36, 1975). An exact grid has such p at every multiple of 1/step;
jitter takes them away.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from calrig.estimation.angles import FloatArray

BIN_DEG = 0.05
FINER = 4
"""Frequencies to a resolution 1/arc: enough not to miss a peak."""


def spectral_window(theta_deg: FloatArray, highest: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies (m,) in cycles per degree from 0 to the highest, and the window's power (m,), 1 at 0."""
    return _of_angles(theta_deg.astype(np.float64).tobytes(), highest)


@lru_cache(maxsize=8)
def _of_angles(angles: bytes, highest: float) -> tuple[FloatArray, FloatArray]:
    """A search asks for the window of the same angles again and again."""
    theta_deg = np.frombuffer(angles)
    first = theta_deg.min()
    bin_deg = min(BIN_DEG, 1.0 / (8.0 * highest))
    counts = np.bincount(np.round((theta_deg - first) / bin_deg).astype(int)).astype(float)
    length = 1 << int(FINER * len(counts) - 1).bit_length()
    window = np.fft.rfft(counts, length)
    frequencies = np.fft.rfftfreq(length, bin_deg)
    wanted = frequencies <= highest
    power = np.abs(window[wanted] / len(theta_deg)) ** 2
    return np.asarray(frequencies[wanted], dtype=np.float64), np.asarray(power, dtype=np.float64)


def window_peaks(theta_deg: FloatArray, highest: float, least: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies (k,) of the window's peaks of at least some power, and their powers (k,)."""
    frequencies, power = spectral_window(theta_deg, highest)
    inner = np.arange(1, len(power) - 1)
    is_peak = (power[inner] >= power[inner - 1]) & (power[inner] > power[inner + 1]) & (power[inner] >= least)
    peaks = inner[is_peak & (frequencies[inner] > 1.0 / np.ptp(theta_deg))]
    return frequencies[peaks], power[peaks]
