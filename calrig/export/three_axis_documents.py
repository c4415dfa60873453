"""What a solution of whole units leaves behind: calibrations (CONTRACT section 6), and the stage's map.

As of units in their plane (`joint_documents`), with `accelerometer` and `gyro` filled: what an elevation
needs is in `effects`, what a vector needs in `accelerometer`.
"""

from __future__ import annotations

from typing import Any

from calrig.calibration.separation import (
    Frame,
    ThreeAxisSolution,
    WholeUnit,
    accelerometer_document,
    gyro_document,
    plane_parameters,
    units_of,
)
from calrig.export.solved_parts import calibration, effects_of_values, stage_map


def three_axis_documents(
    solution: ThreeAxisSolution, frame: Frame = "sensor", rig: str | None = None
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Calibrations by serial, and the map."""
    units = units_of(solution, frame)
    serials = solution.table.units
    calibrations = {serial: _calibration(solution, k, units[k], rig) for k, serial in enumerate(serials)}
    separable = all(unit.worth.rms_deg < solution.noise_deg for unit in units)
    return calibrations, stage_map(solution, separable, rig)


def _calibration(solution: ThreeAxisSolution, unit: int, found: WholeUnit, rig: str | None) -> dict[str, Any]:
    values, size = plane_parameters(solution, unit, found.plane), 1.0 + float(found.plane.own[0])
    own = {
        "effects": effects_of_values(values, size, solution.fit.problem.linear),
        "gyro": _gyro(found),
        "accelerometer": accelerometer_document(found.accelerometer),
    }
    provenance = {
        "faces": sorted(set(solution.of.faces)),
        "separable": found.worth.rms_deg < solution.noise_deg,
    }
    return calibration(solution, unit, found.worth, own, provenance, rig)


def _gyro(found: WholeUnit) -> dict[str, Any]:
    """As section 8 has it, with the scale about x that section 6 has."""
    stated = gyro_document(found.gyro) or {"bias_dps": None}
    matrix = stated.get("matrix")
    bias = stated["bias_dps"] or [None, None, None]
    return {**stated, "bias_dps": bias, "scale": None if matrix is None else matrix[0][0]}
