"""Error of whole stretches that were held out, without the map and with it (`held_out`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calrig.calibration.joint.held_out import HeldOut, predicted
from calrig.calibration.joint.three_axis_fit import ThreeAxisFit, fitted_whole
from calrig.calibration.progress import Progress, unheard


def held_out_of_whole(fit: ThreeAxisFit, progress: Progress = unheard) -> HeldOut:
    """Predicts the angle of every pose that is no outlier, once; tells the share that is done."""
    problem = fit.problem
    seen = replace(problem.table, approach=np.zeros(len(problem.table)))
    believing = replace(problem, of=replace(problem.of, seen=seen), orders=())
    return predicted(
        problem.table,
        fit.kept,
        lambda shown: fitted_whole(believing, shown).left(),
        lambda shown: fitted_whole(problem, shown, fit.parameters).left(),
        progress,
    )
