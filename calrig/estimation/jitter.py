"""Jitter in bins of 100 ms: how much an angle trembles while nothing turns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray

BIN_S = 0.1
MIN_BIN_SAMPLES = 3
_FULL = 0.8
"""Share of the samples due that a bin must hold: one cut short says less than its neighbours."""


@dataclass(frozen=True, slots=True)
class Jitter:
    """Jitter of one signal, all in degrees.

    Attributes:
        std_deg: the jitter "per 100 ms" that filters are compared by: standard deviation (n − 1) about the
            mean of each bin, root-mean-square over the bins.
        peak_to_peak_deg: largest less smallest value within a bin, root-mean-square over the bins.
        step_deg: change of the mean from one bin to the next, root-mean-square (√2 times the Allan deviation
            at 100 ms): what a filter slower than a bin does, which the other two do not see.
        n_bins: how many bins.
    """

    std_deg: float
    peak_to_peak_deg: float
    step_deg: float | None
    n_bins: int


def jitter(
    time_s: FloatArray, angle_deg: FloatArray, static: Sequence[slice], bin_s: float = BIN_S
) -> Jitter | None:
    """The jitter of an angle over the segments in which the sensor stands.

    Nirmal et al., Proc. SPIE 9912 (2016), give 0.330° before and 0.143° after fusion "per 100 ms" and no
    formula; taken here is the one for which the raw figure is the noise of a single sample. Mean and slow
    drift of the angle do not enter it.

    Args:
        time_s: (n,) increasing.
        angle_deg: (n,) continuous; samples without a value (NaN) are passed over.
        static: intervals of the log, each cut into bins from its own beginning.
        bin_s: length of a bin.

    Returns:
        None where no bin is full: segments too short, or fewer than `MIN_BIN_SAMPLES` samples a bin.
    """
    variances, ranges, steps = [], [], []
    for segment in static:
        mean, variance, extent = _bins(time_s[segment], angle_deg[segment], bin_s)
        full = np.isfinite(mean)
        variances.append(variance[full])
        ranges.append(extent[full])
        step = np.diff(mean)
        steps.append(step[np.isfinite(step)])
    if not variances or not (n_bins := sum(len(one) for one in variances)):
        return None
    step_deg = _rms(np.concatenate(steps)) if any(len(one) for one in steps) else None
    std_deg = math.sqrt(float(np.concatenate(variances).mean()))
    return Jitter(std_deg, _rms(np.concatenate(ranges)), step_deg, n_bins)


def _bins(
    time_s: FloatArray, angle_deg: FloatArray, bin_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean, variance and range of each bin in turn; NaN for one that is not full."""
    if len(time_s) < 2:
        return np.empty(0), np.empty(0), np.empty(0)
    start_s, due = float(time_s[0]), bin_s / float(np.median(np.diff(time_s)))
    known = np.isfinite(angle_deg)
    angle_deg = angle_deg[known]
    # half a millionth of a bin: a sample on the border by the decimals of its time belongs to the next
    index = np.floor((time_s[known] - start_s) / bin_s + 5e-7).astype(np.intp)
    mean, variance, extent = np.full((3, int(index[-1]) + 1 if len(index) else 0), np.nan)
    occupied, first, count = np.unique(index, return_index=True, return_counts=True)
    full = count >= max(MIN_BIN_SAMPLES, _FULL * due)
    if not full.any():
        return mean, variance, extent
    means = np.add.reduceat(angle_deg, first) / count
    squares = np.add.reduceat((angle_deg - np.repeat(means, count)) ** 2, first)
    ranges = np.maximum.reduceat(angle_deg, first) - np.minimum.reduceat(angle_deg, first)
    into = occupied[full]
    mean[into], extent[into] = means[full], ranges[full]
    variance[into] = squares[full] / (count[full] - 1)
    return mean, variance, extent


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(values @ values) / len(values))
