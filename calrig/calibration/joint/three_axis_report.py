"""A solution of whole units as CONTRACT section 8's document."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.joint.elevation import Worth, polynomial_of
from calrig.calibration.joint.held_out import held_out_of_whole
from calrig.calibration.joint.mapped import Mapped, mapped
from calrig.calibration.joint.report_parts import (
    UNITS,
    Value,
    figures,
    projected,
    stage_document,
    value,
    worth_document,
)
from calrig.calibration.joint.three_axis_frame import Accelerometer, Frame, accelerometer
from calrig.calibration.joint.three_axis_gyro import WholeGyro, whole_gyro
from calrig.calibration.joint.three_axis_plane import InPlane, in_plane, worth_of_whole
from calrig.calibration.joint.three_axis_said import three_axis_sentences
from calrig.calibration.joint.three_axis_solution import ThreeAxisSolution
from calrig.calibration.joint.unit_model import CURVATURES, NAMES, PER_C
from calrig.calibration.progress import Progress, unheard


@dataclass(frozen=True, slots=True, eq=False)
class WholeUnit:
    """What a solution says of one unit: its elevation, its accelerometer, its gyro."""

    plane: InPlane
    worth: Worth
    accelerometer: Accelerometer | None
    gyro: WholeGyro | None


def units_of(solution: ThreeAxisSolution, frame: Frame = "sensor") -> list[WholeUnit]:
    """Each unit, matrices in the frame asked for."""
    found = []
    for unit in range(len(solution.table.units)):
        plane, whole = in_plane(solution.fit, unit), accelerometer(solution.fit, unit, frame)
        worth = worth_of_whole(solution.fit, unit, plane)
        found.append(WholeUnit(plane, worth, whole, whole_gyro(solution.fit, unit, whole)))
    return found


def three_axis_document(
    solution: ThreeAxisSolution, frame: Frame = "sensor", progress: Progress = unheard
) -> dict[str, Any]:
    """Everything that was solved for, and what it is worth."""
    units, on_stage = units_of(solution, frame), mapped(solution.fit)
    tested = held_out_of_whole(solution.fit, progress)
    told, asked = solution.fit.told()
    return {
        "units": [_unit(solution, k, unit) for k, unit in enumerate(units)],
        "stage": _stage(solution, on_stage),
        "mounts": _mounts(solution, on_stage),
        "separable": all(unit.worth.rms_deg < solution.noise_deg for unit in units),
        "rank": {"told": told, "parameters": asked},
        "advice": None,
        **figures(solution.fit, tested),
        "level_known": False,
        "level_std_deg": None,
        "warnings": [
            *solution.warnings,
            *three_axis_sentences(solution, on_stage, [unit.gyro for unit in units], frame),
        ],
    }


def plane_parameters(solution: ThreeAxisSolution, unit: int, plane: InPlane) -> dict[str, Value]:
    """A unit's parameters about its x axis in the units of documents, as `report.parameters_of` has them."""
    values, stds = plane.own, np.sqrt(np.maximum(np.diag(plane.covariance), 0.0))
    warmed = bool(np.isfinite(solution.table.reference_c[unit]))
    found: dict[str, Value] = {}
    for name, (stated_as, factor) in UNITS.items():
        k = NAMES.index(name)
        if k in PER_C and not warmed:
            continue
        stated = not (solution.fit.problem.linear and k in CURVATURES)
        found[stated_as] = value(factor * values[k], factor * stds[k] if stated else None)
    if warmed:
        found["reference_c"] = value(float(solution.table.reference_c[unit]), None)
    return found


def accelerometer_document(found: Accelerometer | None) -> dict[str, Any] | None:
    """What makes true = matrix·(raw − bias); curvatures q·u² + c·u³ are to be taken off raw before."""
    if found is None:
        return None
    return {
        "bias_g": found.bias_g.tolist(),
        "matrix": found.matrix.tolist(),
        "covariance": found.covariance.tolist(),
        "frame": found.frame,
        "quadratic_g_per_g2": None if found.curvature_g is None else found.curvature_g[0].tolist(),
        "cubic_g_per_g3": None if found.curvature_g is None else found.curvature_g[1].tolist(),
    }


def gyro_document(found: WholeGyro | None) -> dict[str, Any] | None:
    """What makes true = matrix·(raw − bias − dps_per_g·a), time being the board's."""
    if found is None:
        return None
    dwells, turns = found.dwells, found.turns
    return {
        "bias_dps": None if dwells is None else dwells.bias_dps.tolist(),
        "bias_std_dps": None if dwells is None else dwells.bias_std_dps.tolist(),
        "matrix": _listed(found.matrix),
        "matrix_std": _listed(found.matrix_std),
        "dps_per_g": _listed(found.dps_per_g),
        "dps_per_g_std": _listed(found.dps_per_g_std),
        "turns": None
        if turns is None
        else {
            "n": turns.n,
            "closed": turns.closed,
            "both_ways": not turns.one_way,
            "noise_deg": turns.noise_deg,
        },
        "clock": "board",
        "clock_error_ppm": None
        if found.clock is None
        else value(1e6 * found.clock.error, 1e6 * found.clock.std),
    }


def _unit(solution: ThreeAxisSolution, unit: int, found: WholeUnit) -> dict[str, Any]:
    worth, plane = found.worth, found.plane
    coefficients, covariance = polynomial_of(plane.own, plane.covariance, worth.elevation_deg)
    return {
        "unit": solution.table.units[unit],
        "parameters": {
            **plane_parameters(solution, unit, plane),
            **projected(coefficients, covariance, solution.fit.problem.linear),
        },
        "accelerometer": accelerometer_document(found.accelerometer),
        "gyro": gyro_document(found.gyro),
        "noise_mg": (1e3 * solution.fit.noise * solution.fit.problem.shape[unit]).tolist(),
        **worth_document(worth),
        "level": None,
    }


def _stage(solution: ThreeAxisSolution, on_stage: Mapped) -> dict[str, Any]:
    fit, at = solution.fit, solution.fit.problem.dip_at
    dip = value(np.degrees(fit.parameters[at]), np.degrees(fit.stds[at]))
    return {**stage_document(on_stage), "axis_dip_deg": dip}


def _mounts(solution: ThreeAxisSolution, on_stage: Mapped) -> list[dict[str, Any]]:
    fit, faces = solution.fit, solution.of.faces
    return [
        {
            "mount": mount.name,
            "unit": solution.table.units[mount.unit],
            "mount_deg": mount.nominal_deg or 0.0,
            "mount_axis": faces[k],
            "angle_deg": value(mount.on_its_turn(float(on_stage.mounts_deg[k])), on_stage.mounts_std_deg[k]),
            "tilts_deg": np.degrees(fit.parameters[fit.problem.tilts_at(k)]).tolist(),
        }
        for k, mount in enumerate(solution.table.mounts)
    ]


def _listed(matrix: Any) -> list[list[float]] | None:
    return None if matrix is None else matrix.tolist()
