"""How a figure repeats when a unit is clamped anew, on another day or another rig: pooled over all units.

The standard error of one run knows the noise of its poses alone. Units may have changed meanwhile: the runs
between which they did are found first, so that they spoil nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.calibration.variance_components import IntArray, Layout, variance_components
from calrig.estimation.angles import FloatArray

BoolArray = npt.NDArray[np.bool_]

FEWEST_REPEATS = 3
"""Repeats that there must be: of two that disagree nobody can tell which is the change."""
FEWEST_ALIKE = 2
"""Repeats left without what changed; with one, nothing but a factor of 13 would be significant."""
MOST_RUNS = 700
"""Units calibrated last, up to as many runs, are pooled: they tell a spread to 3 % of itself."""
OUTLYING = 0.05
"""Chance that a run of good repeats loses one of them in the search for those that changed."""
HALF_OF_CHI2 = 0.4549
"""Median of χ² with one degree of freedom."""


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Standard deviations of one figure over what is done between two runs of a unit.

    Attributes:
        run: what re-clamping adds, and the day where it cannot be told apart.
        day: what the day of a rig adds; None where it is in `run`.
        rig: between rigs; 0 with one.
        unit: between units; 0 with one.
        freedom: degrees of freedom of `run`, and of the whole where days are told.
    """

    run: float
    day: float | None
    rig: float
    unit: float
    freedom: int

    @property
    def between_days(self) -> float:
        """Standard deviation of a run on another day, beyond its own standard error."""
        return float(np.hypot(self.run, self.day or 0.0))


@dataclass(frozen=True, slots=True)
class Runs:
    """N runs, by unit and within a unit in the order measured.

    Attributes:
        unit, rig, day: (N,) each, from 0; a day is one of one rig.
        value: (N,) the figure; NaN where not known.
        std: (N,) standard error of type A; NaN where not known, which counts as 0.
        stage_variance: (N,) what the stage is worth in the figure (type B); counts where the rig changed.
    """

    unit: IntArray
    rig: IntArray
    day: IntArray
    value: FloatArray
    std: FloatArray
    stage_variance: FloatArray

    def known(self) -> IntArray:
        """Runs that have the figure."""
        return np.flatnonzero(np.isfinite(self.value))


def pairs(unit: IntArray) -> tuple[IntArray, IntArray]:
    """Places of each run and the next of its unit, where units come one after the other."""
    first = np.flatnonzero(unit[1:] == unit[:-1]) if len(unit) else np.empty(0, dtype=np.intp)
    return first, first + 1


def outlying(difference: FloatArray, variance: FloatArray) -> BoolArray:
    """(K,) which of many differences are too large to be repeats of nothing but noise.

    Each has its own `variance` and all share one spread besides. Taken out one after the other, the most
    extreme first, up to nearly half of them; those count that precede the last which is significant beside
    all that remain (the generalised extreme Studentised deviate: Rosner, Technometrics 25, 1983). Their
    shared spread is the s² with Σd²/(v + s²) = n (Paule & Mandel, Journal of Research of the NBS 87, 1982).

    Args:
        difference: (K,) of repeats.
        variance: (K,) what is known of each.
    """
    from scipy.special import stdtrit

    size, n = np.abs(difference), len(difference)
    out = np.zeros(n, dtype=bool)
    if n < FEWEST_REPEATS:
        return out
    squares = size**2
    robust = max(float(np.median(squares)) / HALF_OF_CHI2 - float(np.median(variance)), 0.0)
    extreme = size / np.sqrt(np.maximum(variance + robust, 1e-300))
    order = np.argsort(-extreme, kind="stable")
    most = min((n - 1) // 2, max(int((extreme > 2.5).sum()), 3))  # beyond these nothing stands out
    squares, variance = squares[order], variance[order]
    for taken in range(most, 0, -1):
        rest = slice(taken, None)
        spread = _shared_spread(squares[rest], variance[rest])
        left = n - taken
        limit = float(stdtrit(left, 1.0 - OUTLYING / (2.0 * (left + 1))))
        if squares[taken - 1] > limit**2 * (variance[taken - 1] + spread):
            out[order[:taken]] = True
            return out
    return out


def _shared_spread(squares: FloatArray, variance: FloatArray) -> float:
    """The s² >= 0 with Σ squares/(variance + s²) = n, by Newton's method from below."""
    n, s2 = len(squares), 0.0
    floor = 1e-12 * float(squares.max(initial=1e-300))
    for _ in range(50):
        weight = 1.0 / (variance + s2 + floor)
        excess = float(squares @ weight) - n
        if excess <= 1e-6 * n:
            break
        s2 += excess / float(squares @ weight**2)
    return s2


def repeatability(runs: Runs, changed: IntArray) -> Repeatability | None:
    """How a figure repeats, with what changed kept apart.

    Args:
        runs: by unit, in the order measured.
        changed: places of runs before which their unit changed: from there on it counts as another one.

    Returns:
        None where fewer than `FEWEST_REPEATS` repeats tell, or fewer than `FEWEST_ALIKE` without the changes.
    """
    begins = np.ones(len(runs.unit), dtype=bool)
    begins[1:] = runs.unit[1:] != runs.unit[:-1]
    begins[changed] = True
    kept = _pooled(runs)
    segment = np.unique(np.cumsum(begins)[kept], return_inverse=True)[1]
    repeats = len(kept) - (int(segment.max()) + 1 if len(kept) else 0)
    if len(kept) - len(np.unique(runs.unit[kept])) < FEWEST_REPEATS or repeats < FEWEST_ALIKE:
        return None
    rig = np.unique(runs.rig[kept], return_inverse=True)[1]
    day = np.unique(runs.day[kept], return_inverse=True)[1]
    layout = Layout(segment, rig, day, np.nan_to_num(runs.std[kept]) ** 2)
    found = variance_components(runs.value[kept], layout)
    freedom = repeats
    if found.day is not None:
        freedom = max(min(repeats - (layout.days - layout.rigs), layout.days - layout.rigs), 1)
    root = np.sqrt([found.run, found.day or 0.0, found.rig, found.unit])
    run, of_day, of_rig, of_unit = (float(one) for one in root)
    return Repeatability(run, None if found.day is None else of_day, of_rig, of_unit, freedom)


def _pooled(runs: Runs) -> IntArray:
    """Places of the runs that are pooled: whole units, those with the latest days first."""
    known = runs.known()
    if len(known) <= MOST_RUNS:
        return known
    counts = np.bincount(runs.unit[known])
    latest = np.full(len(counts), -1)
    np.maximum.at(latest, runs.unit[known], runs.day[known])
    order = np.argsort(-latest, kind="stable")
    taken = order[np.cumsum(counts[order]) <= MOST_RUNS]
    return known[np.isin(runs.unit[known], taken)]
