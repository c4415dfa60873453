"""Poses whose noise follows on that of the pose before, made independent."""

from __future__ import annotations

import numpy as np

from calrig.calibration.joint.table import Intp
from calrig.estimation.angles import FloatArray


def whitened(values: FloatArray, place: Intp, chain: Intp, rho: float) -> tuple[FloatArray, FloatArray]:
    """Values (m, …) less what the one before predicts, scaled to the same variance as they had.

    Args:
        values: of poses in the order measured.
        place: (m,) of each pose among those that were taken.
        chain: (m,) the run that each is of: its first pose follows on nothing.
        rho: the correlation from one pose to the next.

    Returns:
        (m, …) whitened, and (m,) log of the share of the variance that is each one's own.
    """
    if rho <= 0.0:
        return values, np.zeros(len(values))
    share = np.zeros(len(values))
    share[1:] = np.where(np.diff(chain) == 0, rho ** np.abs(np.diff(place)), 0.0)
    own = 1.0 - share**2
    across = (slice(None), *[None] * (values.ndim - 1))
    before = np.concatenate([values[:1], values[:-1]])
    return (values - share[across] * before) / np.sqrt(own)[across], np.log(own)
