"""The best of each family of names against searches of noise: its p-value, and how sure that is by now."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calrig.calibration.channels import BoolArray
from calrig.calibration.effects import UNNAMED
from calrig.estimation.angles import FloatArray

QUANTILE, UNNAMED_QUANTILE = 0.98, 0.995
"""Of what a name gains from noise, where its own bar lies: an effect that has a name is likelier beforehand
than a shape that has none, and four times as much of the error rate is spent on it. So a scan of a hundred
instants does not raise the bar for an effect of one parameter.
"""
UNLIKELY = 1e-3
"""Chance that draws known already tell wrongly on which side of the level a p-value lies."""


class Judged:
    """The best of each family against searches of noise (b, L).

    Attributes:
        best, exceeded: of each family, by how much it exceeds its bar, and how many searches do so by more.
        ahead: of the largest of noise, the family that is farthest.
        p_value: of the family that is rarer in noise.
    """

    def __init__(
        self,
        labels: Sequence[str],
        observed: FloatArray,
        null: FloatArray,
        families: Sequence[BoolArray],
    ) -> None:
        judged = [_above_bars(labels, observed, null, family) for family in families]
        self.best = np.array([best for best, _ in judged])
        self.exceeded = np.array([(of_noise >= best).sum() for best, of_noise in judged])
        self.ahead = max(
            best - float(of_noise.max()) if np.isfinite(best) else -np.inf for best, of_noise in judged
        )
        self.p_value = (1 + int(self.exceeded.min())) / (1 + len(null))
        self._draws = len(null)

    def passes(self, level: float, margin: float, bootstraps: int) -> bool | None:
        """Whether the p-value is below a level; None where so many searches of noise leave that open.

        Args:
            level: of the decision.
            margin: by how much to be ahead of all of them is clear.
            bootstraps: how many are enough to take the p-value as it is.
        """
        from scipy.special import bdtr, bdtrc

        if self.ahead > margin:
            return True
        exceeded = self.exceeded.min()
        if self._draws >= bootstraps:
            return self.p_value <= level
        if bdtr(exceeded, self._draws, level) < UNLIKELY:
            return True
        return False if bdtrc(exceeded - 1, self._draws, level) < UNLIKELY else None


def _above_bars(
    labels: Sequence[str], observed: FloatArray, null: FloatArray, family: BoolArray
) -> tuple[float, FloatArray]:
    """By how much the best of a family's names exceeds its own bar, and in (b,) searches of noise.

    The bars are quantiles of noise and observation together: noise that they were set by alone exceeds them
    less often than noise that they have not seen.
    """
    shares = np.array([UNNAMED_QUANTILE if label.startswith(UNNAMED) else QUANTILE for label in labels])
    every = np.sort(np.concatenate([null, observed[None]]), axis=0)
    places = np.minimum((shares * len(every)).astype(int), len(null) - 1)
    bars = np.maximum(every[places, range(len(labels))], 0.0)
    return float((observed - bars)[family].max()), (null - bars)[:, family].max(axis=1)
