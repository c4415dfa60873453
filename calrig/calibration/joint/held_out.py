"""Error of poses that were held out in whole stretches of elevation, believing the stage and solving for it.

A stretch of a mount's dial is left out in one mount at a time: the unit is then foretold at elevations where
it was not seen. Held-out poses between the others would be interpolation (`calibration.blocked_folds`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.joint.least_squares import Fit, fitted
from calrig.calibration.joint.problem import Problem
from calrig.calibration.joint.table import BoolArray, Intp, Table
from calrig.estimation.angles import FloatArray

STRETCHES = 6
FEWEST_OF_A_STRETCH = 2


@dataclass(frozen=True, slots=True)
class HeldOut:
    """RMS of the angle foretold less the angle measured, degrees, and how the poses were held out."""

    before_deg: float
    final_deg: float
    stretches: int
    n_poses: int


def held_out(fit: Fit) -> HeldOut:
    """Foretells every pose that was not left out as wild, once."""
    folds = stretches(fit.problem.table, fit.kept)
    return HeldOut(
        before_deg=_rms_deg(_errors(_without_map(fit.problem), folds, None)),
        final_deg=_rms_deg(_errors(fit.problem, folds, fit.parameters)),
        stretches=int(folds.max()) + 1,
        n_poses=int(fit.kept.sum()),
    )


def believing_the_stage(fit: Fit) -> Fit:
    """The same units and mounts on a stage without a map."""
    return fitted(_without_map(fit.problem), fit.weights)


def _without_map(problem: Problem) -> Problem:
    table = problem.table
    return replace(problem, table=replace(table, approach=np.zeros(len(table))), orders=())


def stretches(table: Table, kept: BoolArray) -> Intp:
    """(n,) fold of each pose: stretches of the dial, another one in each mount; −1 of those not kept."""
    folds = np.full(len(table), -1, dtype=np.intp)
    for k in range(len(table.mounts)):
        rows = np.flatnonzero((table.mount == k) & kept)
        count = max(min(STRETCHES, len(rows) // FEWEST_OF_A_STRETCH), 1)
        rank = np.argsort(np.argsort(table.dial_deg[rows], kind="stable"), kind="stable")
        folds[rows] = (rank * count // max(len(rows), 1) + k) % STRETCHES
    return folds


def _errors(problem: Problem, folds: Intp, start: FloatArray | None) -> FloatArray:
    """(kept,) rad."""
    errors = np.zeros(len(folds))
    for fold in range(int(folds.max()) + 1):
        out = folds == fold
        shown = (~out & (folds >= 0)).astype(np.float64)
        errors[out] = fitted(problem, shown, start).left()[out]
    return errors[folds >= 0]


def _rms_deg(errors: FloatArray) -> float:
    return float(np.degrees(np.sqrt(np.mean(errors**2))))
