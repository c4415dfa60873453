"""What the gyro's own gain makes of an effect: of a few per cent, it acts on all that the gyro feels.

The base has the gain of the commanded moves. Moves that effects add to those are felt by the same gain: a
slip of 20° as one of 20.1°, which no linear model has.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.channels import MOVE, SCALE_UNIT_DEG
from calrig.estimation.angles import FloatArray

GAIN = f"{MOVE}.gain"


class FeltMoves:
    """The gyro's response beside what is linear in it, of all coefficients (p,).

    Args:
        straight: (n, J, p) columns of the linear model, those of the base first.
        names: of the base's.
        channels: names of the J responses.
    """

    def __init__(self, straight: FloatArray, names: Sequence[str], channels: Sequence[str]) -> None:
        self._shape, self._base = straight.shape, len(names)
        self._gain_at = names.index(GAIN) if GAIN in names else None
        self._at = channels.index(MOVE) if MOVE in channels else 0
        self._effects = straight[:, self._at, self._base :]
        self.bends = self._gain_at is not None and bool(self._effects.any())

    def over(self, beta: FloatArray) -> FloatArray:
        """(n, J) what the gain adds."""
        over = np.zeros(self._shape[:2])
        if self.bends:
            over[:, self._at] = self._gain(beta) * (self._effects @ beta[self._base :])
        return over

    def slope(self, beta: FloatArray) -> FloatArray:
        """(n, J, p) its derivative."""
        slope = np.zeros(self._shape)
        if self.bends:
            slope[:, self._at, self._base :] = self._gain(beta) * self._effects
            slope[:, self._at, self._gain_at] = self._effects @ beta[self._base :] / SCALE_UNIT_DEG
        return slope

    def _gain(self, beta: FloatArray) -> float:
        return float(beta[self._gain_at]) / SCALE_UNIT_DEG
