"""Error of whole stretches that were held out, believing the stage and solving for it (`held_out`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calrig.calibration.joint.held_out import HeldOut, stretches
from calrig.calibration.joint.table import Intp
from calrig.calibration.joint.three_axis_fit import ThreeAxisFit, fitted_whole
from calrig.calibration.joint.three_axis_problem import ThreeAxisProblem
from calrig.estimation.angles import FloatArray


def held_out_of_whole(fit: ThreeAxisFit) -> HeldOut:
    """Foretells the angle of every pose that was not left out as wild, once."""
    folds, problem = stretches(fit.problem.table, fit.kept), fit.problem
    seen = replace(problem.table, approach=np.zeros(len(problem.table)))
    believing = replace(problem, of=replace(problem.of, seen=seen), orders=())
    return HeldOut(
        before_deg=_rms_deg(believing, folds, None),
        final_deg=_rms_deg(problem, folds, fit.parameters),
        stretches=int(folds.max()) + 1,
        n_poses=int(fit.kept.sum()),
    )


def _rms_deg(problem: ThreeAxisProblem, folds: Intp, start: FloatArray | None) -> float:
    errors = np.zeros(len(folds))
    for fold in range(int(folds.max()) + 1):
        out = folds == fold
        shown = (~out & (folds >= 0)).astype(np.float64)
        errors[out] = fitted_whole(problem, shown, start).left()[out]
    return float(np.degrees(np.sqrt(np.mean(errors[folds >= 0] ** 2))))
