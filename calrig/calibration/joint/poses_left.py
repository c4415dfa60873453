"""What each pose leaves of its angle, without the stage's map and with it: for pictures."""

from __future__ import annotations

from typing import Any

import numpy as np

from calrig.calibration.joint.held_out import believing_the_stage
from calrig.calibration.joint.mapped import mapped
from calrig.calibration.joint.solution import Solution
from calrig.calibration.joint.stage_map import basis
from calrig.estimation.angles import FloatArray

DECIMALS = 6
"""Of a degree: what is kept to be drawn need not be more."""


def poses_left(solution: Solution) -> dict[str, list[Any]]:
    """Columns of the poses that were not left out as an outlier, in degrees.

    `mount` is the index of the pose's mount, `dial_deg` the stage's own angle, `on_map_deg` the map there
    (less its mean, and without play) with what the pose leaves of it; `before_deg` is what it leaves
    believing the stage, `left_deg` with its map.
    """
    fit, table = solution.fit, solution.table
    before, left = np.degrees(believing_the_stage(fit).left()), np.degrees(fit.left())
    found = mapped(fit)

    def waves(dial_deg: FloatArray) -> FloatArray:
        series = basis(dial_deg, np.zeros(len(dial_deg)), fit.problem.orders)
        return np.asarray(series @ found.coefficients)

    on_map = waves(table.dial_deg) - waves(found.stage_deg).mean() + left
    columns = {"dial_deg": table.dial_deg, "on_map_deg": on_map, "before_deg": before, "left_deg": left}
    return {
        "mount": table.mount[fit.kept].tolist(),
        **{name: _rounded(values[fit.kept]) for name, values in columns.items()},
    }


def _rounded(values: FloatArray) -> list[float]:
    return [round(value, DECIMALS) for value in values.tolist()]
