"""Error of poses that were held out in whole stretches of elevation, without a map of the stage and with it.

A stretch of a mount's dial is left out in one mount at a time: the unit is then predicted at elevations where
it was not seen. Held-out poses between the others would be interpolation (`calibration.blocked_folds`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.progress import Progress, unheard, within
from calrig.calibration.separation.least_squares import Fit, fitted
from calrig.calibration.separation.pose_table import BoolArray, Intp, Table
from calrig.calibration.separation.problem import Problem
from calrig.calibration.separation.three_axis_fit import ThreeAxisFit, fitted_whole
from calrig.estimation.angles import FloatArray

STRETCHES = 6
FEWEST_OF_A_STRETCH = 2


@dataclass(frozen=True, slots=True)
class HeldOut:
    """RMS of the angle predicted less the angle measured, degrees, and how the poses were held out."""

    before_deg: float
    final_deg: float
    stretches: int
    n_poses: int


Left = Callable[[FloatArray], FloatArray]
"""(n,) angles measured less those expected, rad, of a fit by weights (n,) of the poses."""


def held_out(fit: Fit, progress: Progress = unheard) -> HeldOut:
    """Predicts every pose that was not left out as an outlier, once; tells the share that is done."""
    problem, believing = fit.problem, _without_map(fit.problem)
    return _predicted(
        problem.table,
        fit.kept,
        lambda shown: fitted(believing, shown).left(),
        lambda shown: fitted(problem, shown, fit.parameters).left(),
        progress,
    )


def held_out_of_whole(fit: ThreeAxisFit, progress: Progress = unheard) -> HeldOut:
    """The same of whole units."""
    problem = fit.problem
    believing = replace(problem, of=replace(problem.of, seen=_played_out(problem.table)), orders=())
    return _predicted(
        problem.table,
        fit.kept,
        lambda shown: fitted_whole(believing, shown).left(),
        lambda shown: fitted_whole(problem, shown, fit.parameters).left(),
        progress,
    )


def _predicted(table: Table, kept: BoolArray, believing: Left, solved: Left, progress: Progress) -> HeldOut:
    """By any two fits of the poses kept: without the map, and with it."""
    folds = stretches(table, kept)
    return HeldOut(
        before_deg=_rms_deg(believing, folds, within(progress, 0.0, 0.5)),
        final_deg=_rms_deg(solved, folds, within(progress, 0.5, 1.0)),
        stretches=int(folds.max()) + 1,
        n_poses=int(kept.sum()),
    )


def believing_the_stage(fit: Fit) -> Fit:
    """The same units and mounts on a stage without a map."""
    return fitted(_without_map(fit.problem), fit.weights)


def _without_map(problem: Problem) -> Problem:
    return replace(problem, table=_played_out(problem.table), orders=())


def _played_out(table: Table) -> Table:
    """The poses as if the stage had no play."""
    return replace(table, approach=np.zeros(len(table)))


def stretches(table: Table, kept: BoolArray) -> Intp:
    """(n,) fold of each pose: stretches of the dial, another one in each mount; −1 of those not kept."""
    folds = np.full(len(table), -1, dtype=np.intp)
    for k in range(len(table.mounts)):
        rows = np.flatnonzero((table.mount == k) & kept)
        count = max(min(STRETCHES, len(rows) // FEWEST_OF_A_STRETCH), 1)
        rank = np.argsort(np.argsort(table.dial_deg[rows], kind="stable"), kind="stable")
        folds[rows] = (rank * count // max(len(rows), 1) + k) % STRETCHES
    return folds


def _rms_deg(left: Left, folds: Intp, progress: Progress) -> float:
    errors = np.zeros(len(folds))
    count = int(folds.max()) + 1
    for fold in range(count):
        progress(fold / count)
        out = folds == fold
        errors[out] = left((~out & (folds >= 0)).astype(np.float64))[out]
    return float(np.degrees(np.sqrt(np.mean(errors[folds >= 0] ** 2))))
