"""How far values spread, whatever a few of them do."""

from __future__ import annotations

import numpy as np

from calrig.estimation.angles import FloatArray

MAD_TO_STD = 1.4826
"""Standard deviation over the median absolute deviation, of normal values: 1/Φ⁻¹(3/4)."""


def robust_std(values: FloatArray) -> float:
    """The standard deviation by the median absolute deviation, in the values' unit.

    Args:
        values: (n,), n >= 1.
    """
    return MAD_TO_STD * float(np.median(np.abs(values - np.median(values))))
