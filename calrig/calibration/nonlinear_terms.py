"""What effects add that their columns do not say, each of its own coefficients alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.candidates import Candidate
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

STEP = 1e-3
"""Of a coefficient, to see what it does there."""


class NonlinearTerms:
    """The responses beside what is linear in them, of all coefficients (p,).

    Args:
        r: the responses.
        members: the effects of a model.
        own: where the coefficients of each lie among all.
    """

    def __init__(self, r: Responses, members: Sequence[Candidate], own: Sequence[slice]) -> None:
        self._r = r
        self._bent = [
            (member.effect.not_linear, at)
            for member, at in zip(members, own, strict=True)
            if member.effect.not_linear is not None and member.changed is None
        ]
        self.bends = bool(self._bent)

    def over(self, beta: FloatArray) -> FloatArray:
        """(n, J) what they add."""
        over = np.zeros_like(self._r.values)
        for not_linear, at in self._bent:
            over += self._r.columns(not_linear(self._r, beta[at]))[:, :, 0]
        return over

    def slope(self, beta: FloatArray) -> FloatArray:
        """(n, J, p) its derivative, by central differences."""
        slope = np.zeros((*self._r.values.shape, len(beta)))
        for _, at in self._bent:
            for k in range(at.start, at.stop):
                change = np.zeros(len(beta))
                change[k] = STEP
                slope[:, :, k] = (self.over(beta + change) - self.over(beta - change)) / (2.0 * STEP)
        return slope
