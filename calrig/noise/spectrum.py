"""Power spectral density by Welch's method, and its slope on a double logarithmic scale."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq
from scipy.signal import welch
from scipy.special import digamma, gammaincinv, polygamma

from calrig.estimation.angles import FloatArray

LONGEST = 2**15
"""Samples in a piece at most: finer bins show nothing more of a slope, and cost."""
AVERAGES = 15
"""Pieces wanted: eight side by side and those half over them."""
SHORTEST = 16
_CHUNK = 2**20
FIRST_BIN, LAST_SHARE = 4, 0.8
"""What a slope is fitted over: from the fourth bin, below which taking the mean shows, to 0.8 of Nyquist,
above which a chip's own low-pass filter does."""
GROUPS_PER_OCTAVE = 4
_LINE_BINS = 4
_HALF_OVER, _NEIGHBOURS = 1.056, 1.94
"""Pieces and bins worth one independent one: Hann's window correlates the squares of half overlapping
pieces by 1/36, those of neighbouring bins by 4/9 and 1/36."""


@dataclass(frozen=True, slots=True, eq=False)
class Psd:
    """One-sided power spectral density.

    Attributes:
        frequency_hz: (M,) from 0 to half the rate.
        density: (M,) in unit²/Hz.
        averages: how many pieces, each half over the last, it is the mean of; 0 where the log is too short.
    """

    frequency_hz: FloatArray
    density: FloatArray
    averages: int


@dataclass(frozen=True, slots=True)
class PsdSlope:
    """Exponent α of a density that goes as f^α: 0 is white, −1 pink, −2 brown.

    Attributes:
        slope: α.
        std: its standard error, enlarged where the density is no straight line.
        low_hz, high_hz: what it was fitted over.
    """

    slope: float
    std: float
    low_hz: float
    high_hz: float


def psd_of(x: FloatArray, rate_hz: float, segments: Sequence[slice]) -> Psd:
    """Welch's estimate (IEEE Trans. AU 15, 1967): Hann's window, half overlap, each piece about its mean.

    No piece reaches over a gap. Its length is the largest power of two that gives `AVERAGES` pieces, or the
    one that gives most where none does.

    `x` (N,) is finite; `segments` are runs of samples without a gap.
    """
    size = _piece([part.stop - part.start for part in segments])
    if size == 0:
        return Psd(np.zeros(0), np.zeros(0), 0)
    total, averages = np.zeros(size // 2 + 1), 0
    for part in segments:
        # in chunks: scipy holds all pieces' transforms at once
        for start in range(part.start, part.stop - size + 1, _CHUNK):
            chunk = x[start : min(start + _CHUNK + size // 2, part.stop)]
            count = _pieces(len(chunk), size)
            total += count * welch(chunk, fs=rate_hz, nperseg=size, detrend="constant")[1]
            averages += count
    frequency_hz = np.asarray(np.fft.rfftfreq(size, 1.0 / rate_hz), dtype=np.float64)
    return Psd(frequency_hz, total / averages, averages)


def _piece(lengths: Sequence[int]) -> int:
    """Return samples in a piece; 0 where there is none of `SHORTEST`."""
    best, most = 0, 0
    size = LONGEST
    while size >= SHORTEST:
        count = sum(_pieces(n, size) for n in lengths if n >= size)
        if count >= AVERAGES:
            return size
        if count > most:
            best, most = size, count
        size //= 2
    return best


def _pieces(length: int, size: int) -> int:
    return (length - size) // (size // 2) + 1


def psd_slope(psd: Psd, lines_hz: Sequence[float] = ()) -> PsdSlope | None:
    """Return the slope of log density over log frequency, every octave counting alike.

    The bins are taken together in `GROUPS_PER_OCTAVE` groups an octave, each by the median of its logarithms,
    freed of the bias of the logarithm of a chi-square; a line is left out by the bins around it and cannot
    move a median far. Groups are weighted by what they are worth, no more than a deviation from the straight
    line allows.

    `lines_hz` are known lines.

    Returns:
        None with fewer than five groups.
    """
    f, density = psd.frequency_hz, psd.density
    if len(f) < FIRST_BIN + 2:
        return None
    width = float(f[1])
    used = (f >= FIRST_BIN * width) & (f <= LAST_SHARE * f[-1]) & (density > 0.0)
    for line_hz in lines_hz:
        used &= np.abs(f - line_hz) > _LINE_BINS * width
    f, density = f[used], density[used]
    group = np.floor(np.log2(f / (FIRST_BIN * width)) * GROUPS_PER_OCTAVE + 1e-9)
    kinds, starts = np.unique(group, return_index=True)
    if len(kinds) < 5:
        return None
    free = psd.averages / _HALF_OVER if psd.averages > 1 else 1.0
    groups = [
        _group(np.log(f[a:b]), np.log(density[a:b]), free) for a, b in pairwise([*starts.tolist(), len(f)])
    ]
    slope, std = _straight_line(*np.array(groups).T)
    return PsdSlope(slope, std, float(f[0]), float(f[-1]))


def _group(log_f: FloatArray, log_density: FloatArray, free: float) -> tuple[float, float, float]:
    """Place and height of a group of bins, each a mean of `free` exponentials, and the height's variance."""
    count = len(log_f)
    variance = float(polygamma(1, free)) / max(count / _NEIGHBOURS, 1.0)
    if count <= 2:
        bias = float(digamma(free)) - math.log(free)
    else:
        bias = math.log(float(gammaincinv(free, 0.5)) / free)
        variance *= math.pi / 2.0
    return float(np.median(log_f)), float(np.median(log_density)) - bias, variance


def _straight_line(x: FloatArray, y: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """Return slope and its standard error; what the variances do not explain is a variance common to all.

    Paule & Mandel, J. Res. NBS 87, 1982.
    """

    def fit(common: float) -> tuple[float, float, float]:
        w = 1.0 / (variance + common)
        dx = x - w @ x / w.sum()
        slope = float((w * dx) @ y / ((w * dx) @ dx))
        rest = y - w @ y / w.sum() - slope * dx
        return slope, float(((w * dx) @ dx) ** -0.5), float((w * rest) @ rest) - (len(x) - 2)

    common = 0.0
    if fit(0.0)[2] > 0.0:
        common = float(brentq(lambda value: fit(value)[2], 0.0, 2.0 * float(np.ptp(y)) ** 2 + 1.0))
    slope, std, _ = fit(common)
    return slope, std
