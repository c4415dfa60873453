"""Error of poses that were held out in whole stretches of elevation, without a map of the stage and with it.

A stretch of a mount's dial is left out in one mount at a time: the unit is then predicted at elevations where
it was not seen. Held-out poses between the others would be interpolation (`calibration.blocked_folds`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.progress import Progress, unheard, within
from calrig.calibration.separation.least_squares import Fit, fitted
from calrig.calibration.separation.pose_table import Table
from calrig.calibration.separation.problem import Problem
from calrig.estimation.angles import BoolArray, FloatArray, Intp

STRETCHES = 6
FEWEST_OF_A_STRETCH = 2


@dataclass(frozen=True, slots=True)
class HeldOut:
    """RMS of the angle predicted less the angle measured, degrees, and how the poses were held out."""

    before_deg: float
    final_deg: float
    stretches: int
    n_poses: int


def held_out(fit: Fit, progress: Progress = unheard) -> HeldOut:
    """Predict every pose that was not left out as an outlier, once; report the share that is done."""
    folds = stretches(fit.problem.table, fit.kept)
    believing = _without_map(fit.problem)
    return HeldOut(
        before_deg=_rms_deg(lambda shown: fitted(believing, shown).left(), folds, within(progress, 0.0, 0.5)),
        final_deg=_rms_deg(
            lambda shown: fitted(fit.problem, shown, fit.parameters).left(), folds, within(progress, 0.5, 1.0)
        ),
        stretches=int(folds.max()) + 1,
        n_poses=int(fit.kept.sum()),
    )


def believing_the_stage(fit: Fit) -> Fit:
    """The same units and mounts on a stage without a map."""
    return fitted(_without_map(fit.problem), fit.weights)


def _without_map(problem: Problem) -> Problem:
    """As if the stage had neither errors nor backlash."""
    return replace(problem, table=replace(problem.table, approach=np.zeros(len(problem.table))), orders=())


def stretches(table: Table, kept: BoolArray) -> Intp:
    """(n,) fold of each pose: stretches of the dial, another one in each mount; −1 of those not kept."""
    folds = np.full(len(table), -1, dtype=np.intp)
    for k in range(len(table.mounts)):
        rows = np.flatnonzero((table.mount == k) & kept)
        count = max(min(STRETCHES, len(rows) // FEWEST_OF_A_STRETCH), 1)
        rank = np.argsort(np.argsort(table.dial_deg[rows], kind="stable"), kind="stable")
        folds[rows] = (rank * count // max(len(rows), 1) + k) % STRETCHES
    return folds


def _rms_deg(left: Callable[[FloatArray], FloatArray], folds: Intp, progress: Progress) -> float:
    """Of the angles (n,) that fits by weights (n,) leave, each of those held out."""
    errors = np.zeros(len(folds))
    count = int(folds.max()) + 1
    for fold in range(count):
        progress(fold / count)
        out = folds == fold
        errors[out] = left((~out & (folds >= 0)).astype(np.float64))[out]
    return float(np.degrees(np.sqrt(np.mean(errors[folds >= 0] ** 2))))
