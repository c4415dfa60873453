"""How a channel depends on temperature, with an error that allows for noise that is correlated and drifts.

A slow noise and a slow warming look alike: as many independent samples as a log has would give an error that
is far too small. The log is taken in means over up to 64 equal parts. What is left of them beside the
straight line over temperature is taken as white noise plus a first-order autoregression, with shares and a
correlation time that the data tell (by restricted likelihood: Harville, JASA 72, 1977); times far beyond the
log's length make it a random walk. The slope is that of least squares; its variance is what such noise makes
of it, averaged over the possible shares and times by their likelihood.
"""

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from calrig.estimation.angles import FloatArray, IntArray
from calrig.model.noise import TemperatureDependence

MIN_SPAN_C = 1.0
"""What the parts' temperatures must span."""
MIN_CORRELATION = 0.5
"""Of one part's temperature with the next one's; with less it is the thermometer's own noise."""
MIN_PARTS = 16
MOST_PARTS = 64
_MIN_SAMPLES = 4
_SHARES = 10.0 ** np.arange(-6.0, 4.1, 1.0)
_TIMES = 2.0 ** np.arange(0.0, 11.0, 1.5)


def temperature_of(
    x: FloatArray,
    temperature_c: FloatArray | None,
    rate_hz: float,
    segments: Sequence[slice],
    start_s: Sequence[float],
) -> TemperatureDependence | None:
    """Return the slope of a channel over temperature.

    `x` and `temperature_c` (N,) are finite; each segment is a run of samples without a gap and begins at its
    `start_s`.

    Returns:
        None without temperature, with fewer than `MIN_PARTS` parts, or where their temperatures span less
        than `MIN_SPAN_C` or correlate with the next one's by less than `MIN_CORRELATION`.
    """
    parts = min(MOST_PARTS, len(x) // _MIN_SAMPLES)
    if temperature_c is None or parts < MIN_PARTS:
        return None
    bounds = np.linspace(0, len(x), parts + 1).astype(np.int64)
    warmth = _means(temperature_c, bounds)
    warmer = warmth - warmth.mean()
    if np.ptp(warmth) < MIN_SPAN_C or warmer[1:] @ warmer[:-1] < MIN_CORRELATION * (warmer @ warmer):
        return None
    y, t = _means(x, bounds), _times(bounds, rate_hz, segments, start_s)
    columns = np.stack([np.ones(parts), warmer], axis=1)
    inverse = np.linalg.pinv(columns)
    rest = y - columns @ (inverse @ y)
    excess_c = temperature_c - temperature_c.mean()
    per_c = float(excess_c @ x / (excess_c @ excess_c))
    std = math.sqrt(_variance(rest, columns, inverse[1], t)) if rest.any() else 0.0
    return TemperatureDependence(per_c=per_c, std=std)


def _means(x: FloatArray, bounds: IntArray) -> FloatArray:
    return np.asarray(np.add.reduceat(x, bounds[:-1]) / np.diff(bounds), dtype=np.float64)


def _times(
    bounds: IntArray,
    rate_hz: float,
    segments: Sequence[slice],
    start_s: Sequence[float],
) -> FloatArray:
    """Return (parts,) when the middle sample of each part was taken, in parts of the log's mean length."""
    middle = (bounds[1:] + bounds[:-1]) // 2
    first = np.array([segment.start for segment in segments])
    segment = np.searchsorted(first, middle, side="right") - 1
    t = np.asarray(start_s)[segment] + (middle - first[segment]) / rate_hz
    return np.asarray((t - t[0]) / (t[-1] - t[0]) * (len(t) - 1), dtype=np.float64)


def _variance(rest: FloatArray, columns: FloatArray, slope_of: FloatArray, t: FloatArray) -> float:
    """Return variance of the slope under white noise and an autoregression, over their shares and its times.

    `rest` (parts,) are residuals of least squares, `columns` (parts, 2) of the fit; the slope is the product
    of `slope_of` (parts,) with the means, at times `t` in parts.
    """
    n, p = columns.shape
    apart = np.abs(t[:, None] - t)
    likelihood, variance = [], []
    for share, time in product(_SHARES, _TIMES):
        # the factor of time keeps the steps from part to part alike, whatever the time
        covariance = np.eye(n) + share * time * np.exp(-apart / time)
        root = np.linalg.cholesky(covariance)
        x, e = np.linalg.solve(root, columns), np.linalg.solve(root, rest)
        information = x.T @ x
        e = e - x @ np.linalg.solve(information, x.T @ e)
        scale = float(e @ e) / (n - p)
        determinants = 2.0 * float(np.log(np.diag(root)).sum()) + float(np.linalg.slogdet(information)[1])
        likelihood.append(-0.5 * (determinants + (n - p) * math.log(scale)))
        variance.append(scale * float(slope_of @ covariance @ slope_of))
    weight = np.exp(np.array(likelihood) - max(likelihood))
    return float(weight @ np.array(variance) / weight.sum())
