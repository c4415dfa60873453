"""Samples that lie further out than chance puts them."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from calrig.estimation.angles import FloatArray

LEAST_SIGMAS = 5.0
EXPECTED = 0.05
"""Outliers that a Gaussian log of this length would show."""
_AROUND = 128
_LOOKED_AT = 200_000
_QUARTILES = 2.0 * 0.6744897501960817


def count_outliers(x: FloatArray, step: float) -> int:
    """Samples beyond `LEAST_SIGMAS`, in long logs more, both of the whole log and of their surroundings.

    Sigma is by the quartiles, which outliers do not move. A sample that lies far out because the channel
    drifted there lies well among its neighbours, and one that a slow noise brought away from its neighbours
    lies well in the whole.

    Args:
        x: (N,) finite samples in order.
        step: what they are rounded to; 0 if they are not.
    """
    sigmas = max(LEAST_SIGMAS, -float(ndtri(EXPECTED / (2.0 * max(len(x), 1)))))
    thinned = x[:: max(len(x) // _LOOKED_AT, 1)]
    limit = sigmas * _spread(thinned, step) + step / 2.0
    suspects = np.flatnonzero(np.abs(x - np.median(thinned)) > limit)
    if len(suspects) == 0:
        return 0
    around = min(_AROUND, len(x))
    blocks = np.unique(np.minimum(suspects // around, len(x) // around - 1))
    windows = x[: len(x) // around * around].reshape(-1, around)
    middle = np.median(windows[blocks], axis=1)
    all_blocks = windows[:: max(len(windows) // (_LOOKED_AT // _AROUND), 1)]
    nearby = all_blocks - np.median(all_blocks, axis=1, keepdims=True)
    limit = sigmas * _spread(nearby.ravel(), step) + step / 2.0
    block = np.searchsorted(blocks, np.minimum(suspects // around, len(x) // around - 1))
    return int(np.count_nonzero(np.abs(x[suspects] - middle[block]) > limit))


def _spread(x: FloatArray, step: float) -> float:
    """Standard deviation of the Gaussian of the same quartiles; rounded values are spread over their step.

    The quartiles of rounded values are steps themselves: one is found within its step by the share of the
    samples below it.
    """
    low, high = (_quantile(x, share, step) for share in (0.25, 0.75))
    return float(max((high - low) / _QUARTILES, step / 12.0**0.5))


def _quantile(x: FloatArray, share: float, step: float) -> float:
    value = float(np.quantile(x, share))
    if step == 0.0:
        return value
    below = int(np.count_nonzero(x < value - step / 2.0))
    at = np.count_nonzero(np.abs(x - value) <= step / 2.0)
    return float(value - step / 2.0 + step * (share * len(x) - below) / max(int(at), 1))
