"""How many independent samples correlated ones are worth."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from calrig.estimation.angles import FloatArray

_WHOLE = 2**17
"""Samples whose autocovariance is taken at every lag; of longer logs the far lags are those of means."""
_PIECE = 2**14
_PIECES = 24


def effective_sample_sizes(centred: FloatArray) -> tuple[float, float]:
    """What the samples are worth for their third and fourth moment: n/Σρ(j)³ and n/Σρ(j)⁴ over all lags.

    Args:
        centred: (N,) samples about their mean, not all 0.
    """
    n = len(centred)
    if n <= _WHOLE:
        near, far, block = _autocovariance(centred, n), np.zeros(0), 1
    else:
        near = _near(centred)
        block = -(-n // _WHOLE)
        means = centred[: n // block * block].reshape(-1, block).mean(axis=1)
        far = _autocovariance(means, len(means))[len(near) // block + 1 :]
    worth = []
    for power in (3, 4):
        rho = (near / near[0]) ** power
        total = 2.0 * float(rho.sum()) - 1.0 + 2.0 * block * float(((far / near[0]) ** power).sum())
        worth.append(n / max(total, 1.0))
    return worth[0], worth[1]


def _near(centred: FloatArray) -> FloatArray:
    """Autocovariance up to half of `_PIECE`, from pieces spread over the log."""
    starts = np.linspace(0, len(centred) - _PIECE, _PIECES).astype(np.int64)
    covariance = sum(_autocovariance(centred[start : start + _PIECE], _PIECE // 2) for start in starts)
    return np.asarray(covariance / _PIECES, dtype=np.float64)


def _autocovariance(x: FloatArray, lags: int) -> FloatArray:
    """(lags,) Σ x[i]·x[i + j]/n, without taking the mean out again."""
    transform = rfft(x, next_fast_len(len(x) + lags, real=True))
    power = transform.real**2 + transform.imag**2
    covariance = irfft(power, next_fast_len(len(x) + lags, real=True))[:lags] / len(x)
    return np.asarray(covariance, dtype=np.float64)
