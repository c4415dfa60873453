"""Peaks of a periodogram: where they may lie, and how far they stand out of the noise around them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.special import digamma, fdtrc, gammaincinv

from calrig.estimation.angles import FloatArray

IntArray = npt.NDArray[np.int64]

LOWEST = 2
"""Bins that the taken straight line and the ends' taper spoil."""
GUARD = 2
"""Bins on either side of a peak that belong to it."""
_NEAR, _REACH = 12, 96
_NARROW_P, _NARROW_SHARE = 1e-4, 0.1
_LEAST_BINS = 6
MOST_CANDIDATES = 512
_CLIP = 5.0
_MEDIAN_EFFICIENCY = math.log(2.0) ** 2
_STEEP, _BLOCK = 768, 256


def candidates(power: FloatArray, significance: float) -> IntArray:
    """Bins beside which a significant peak may lie, highest over a rough background first.

    Two neighbouring bins hold at least 0.81 of a sinusoid's power. Where the background is known roughly
    only, at the lowest bins, they need less to be looked at.

    Args:
        power: (M,) of each bin.
        significance: family-wise p-value, over all bins.
    """
    pair = power[:-1] + power[1:]
    pair /= rough_background(power)[:-1]
    pair[: LOWEST + 1] = 0.0
    needed = math.log(len(power) / significance)
    chosen = np.flatnonzero(pair > 0.5 * needed)
    low = np.flatnonzero(pair[:_STEEP] > 0.35 * needed)
    chosen = np.union1d(low, chosen)
    chosen = chosen[np.argsort(pair[chosen])[::-1]][:MOST_CANDIDATES]
    return np.asarray(np.where(power[chosen + 1] > power[chosen], chosen + 1, chosen), dtype=np.int64)


def rough_background(power: FloatArray, averaged: int = 1) -> FloatArray:
    """(M,) mean of the noise in each bin, by the medians of blocks of bins, wider at higher frequency."""
    edges = [0, LOWEST]
    while edges[-1] < min(_STEEP, len(power)):
        edges.append(edges[-1] + max(4, edges[-1] // 2))
    edges = [*edges[:-1], min(edges[-1], len(power))]
    level = np.empty_like(power)
    for a, b in pairwise(edges):
        level[a:b] = np.median(power[a:b])
    first = edges[-1]
    last = first + (len(power) - first) // _BLOCK * _BLOCK
    level[first:last] = np.repeat(np.median(power[first:last].reshape(-1, _BLOCK), axis=1), _BLOCK)
    if last < len(power):
        level[last:] = np.median(power[max(len(power) - _BLOCK, LOWEST) :])
    return np.asarray(np.maximum(level, np.finfo(np.float64).tiny) / _median(averaged), dtype=np.float64)


def _median(averaged: int) -> float:
    """Median of a mean of exponentials of mean 1."""
    return float(gammaincinv(averaged, 0.5)) / averaged


def excess(power: FloatArray, k: int, height: float, averaged: int) -> tuple[float, float]:
    """How a peak compares with its surroundings.

    The background is the power law, or from 48 bins on its parabola on a double logarithmic scale, that fits
    the bins around best.

    Args:
        power: (M,) of each bin, exponential about the background, or means over `averaged` such.
        k: the peak's bin.
        height: the peak's power; `power[k]` or a maximum beside it.
        averaged: independent values that each bin is the mean of.

    Returns:
        The ratio of the peak to the background, and the p-value of such a ratio at this one bin; 1 where the
        peak is not narrow.
    """
    j = np.arange(max(LOWEST, k - _REACH, k // 3), min(len(power) - 1, k + _REACH + 1, 3 * k + 1))
    j = j[np.abs(j - k) > GUARD]
    if len(j) < _LEAST_BINS:
        return 1.0, 1.0
    u = np.log(j / k)
    columns = np.stack([np.ones_like(u), u, u * u][: 3 if len(j) >= 48 else 2], axis=1)
    values = np.maximum(power[j], np.finfo(np.float64).tiny)
    inverse = np.linalg.pinv(columns)
    fitted = inverse @ (np.log(values) + math.log(averaged) - digamma(averaged))
    for _ in range(5):
        shares = np.minimum(values * np.exp(-columns @ fitted), _CLIP)
        fitted = fitted + inverse @ (shares - 1.0)
    background = math.exp(fitted[0])
    spread = float(np.sum((shares - 1.0) ** 2)) * averaged / (len(j) - columns.shape[1])
    inflation = max(spread, 1.0) if averaged > 1 else 1.0
    freedom = averaged / inflation
    around = freedom / float(inverse[0] @ inverse[0])
    ratio = height / background
    near = np.abs(j - k) <= _NEAR
    beside = float(np.median(values[near] * np.exp(-columns[near] @ fitted)))
    beside /= _median(averaged)
    few = freedom * _MEDIAN_EFFICIENCY * float(np.count_nonzero(near))
    narrow = (
        beside - 1.0 <= _NARROW_SHARE * (ratio - 1.0)
        and fdtrc(2.0 * freedom, 2.0 * few, ratio / beside) < _NARROW_P
    )
    return ratio, float(fdtrc(2.0 * freedom, 2.0 * around, ratio)) if narrow else 1.0
