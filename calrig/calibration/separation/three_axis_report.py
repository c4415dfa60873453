"""What a person should know of a solution of whole units: what the poses did not tell, and what would.

A solution of whole units as CONTRACT section 8's document.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calrig.calibration.progress import Progress, unheard
from calrig.calibration.separation.held_out import held_out_of_whole
from calrig.calibration.separation.level import ElevationUncertainty, polynomial_of
from calrig.calibration.separation.map_report import Mapped, mapped
from calrig.calibration.separation.messages import OFF_DEG, is_better, of_untold_orders
from calrig.calibration.separation.report import (
    UNITS,
    Value,
    figures,
    projected,
    stage_document,
    uncertainty_document,
    value,
)
from calrig.calibration.separation.stage_map import TURN_DEG, goes_round, widest_gap_deg
from calrig.calibration.separation.three_axis_fit import ThreeAxisSolution, fitted_whole
from calrig.calibration.separation.three_axis_frame import (
    Accelerometer,
    Frame,
    InPlane,
    accelerometer,
    axes_of,
    in_plane,
    seats_std_rad,
    untold,
    worth_of_whole,
)
from calrig.calibration.separation.three_axis_gyro import WholeGyro, whole_gyro
from calrig.calibration.separation.unit_model import CURVATURES, NAMES, PER_C
from calrig.estimation.angles import AXES, wrap_deg

CLOCK_ERRORS = 3.0
"""Standard errors from which a clock is said to be off."""


def three_axis_sentences(
    solution: ThreeAxisSolution, on_stage: Mapped, gyros: Sequence[WholeGyro | None], frame: Frame
) -> list[str]:
    """All that is to be said, the weightiest first."""
    said = _of_linear(solution)
    for unit, gyro in enumerate(gyros):
        said += [*_of_accelerometer(solution, unit, frame), *_of_gyro(solution.table.units[unit], gyro)]
    return [*said, *_of_mounts(solution, on_stage), *_of_dial(solution)]


def _of_accelerometer(solution: ThreeAxisSolution, unit: int, frame: Frame) -> list[str]:
    """What of it the poses do not tell, and how well its seats repeat."""
    fit, serial, axes = solution.fit, solution.table.units[unit], axes_of(solution.fit, unit)
    missing = [axis for axis in AXES if axis not in axes]
    if names := untold(fit, unit):
        told, asked = fit.told()
        remedy = (
            f": clamp it with its {' and its '.join(missing)} along the stage's axis too" if missing else ""
        )
        return [
            f"unit {serial}: these poses do not tell {', '.join(names)} ({told} of {asked} parameters are "
            f"told, by singular values), so there is no matrix of it{remedy}"
        ]
    if frame == "faces" and len(axes) == len(AXES):
        seat_deg = float(np.degrees(seats_std_rad(fit, unit)))
        return [
            f"unit {serial}: the faces were off by {seat_deg:.2g}° from being square, root mean square: the "
            "frame of the matrix is as good as that, its other six numbers are better"
        ]
    return []


def _of_gyro(serial: str, gyro: WholeGyro | None) -> list[str]:
    if gyro is None:
        return []
    said = []
    if gyro.turns is None:
        said.append(
            f"unit {serial}: no gyro matrix: it needs gyro_move_x_deg, gyro_move_y_deg and gyro_move_z_deg "
            "of moves in mounts with x, y and z along the stage's axis"
        )
    else:
        if not gyro.turns.closed:
            said.append(
                f"unit {serial}: no full turns: the gyro's scale rests on the stage's map; turns of 360° "
                "between dwells do not"
            )
        if gyro.turns.one_way:
            said.append(
                f"unit {serial}: turned one way only: Earth's rate and gravity's influence stay in the "
                "gyro's matrix and its uncertainty; turn both ways"
            )
    if gyro.clock is not None and abs(gyro.clock.error) > CLOCK_ERRORS * gyro.clock.std:
        way = "fast" if gyro.clock.error > 0.0 else "slow"
        said.append(
            f"unit {serial}: the board's clock is {way} by {1e6 * abs(gyro.clock.error):.0f} ppm ± "
            f"{1e6 * gyro.clock.std:.0f} ppm of the host's; the gyro's matrix is for the board's seconds"
        )
    if gyro.dwells is not None and not gyro.dwells.told:
        said.append(f"unit {serial}: these attitudes do not tell what gravity does to the gyro")
    return said


def _of_linear(solution: ThreeAxisSolution) -> list[str]:
    """Whether the poses contradict that the units are."""
    fit = solution.fit
    if not fit.problem.linear:
        return []
    bent = fitted_whole(replace(fit.problem, linear=False), fit.weights, fit.parameters)
    said = "the units are stated to be linear, and these poses contradict that"
    return [said] if is_better(bent, fit) else []


def _of_mounts(solution: ThreeAxisSolution, on_stage: Mapped) -> list[str]:
    """Mounts that stand elsewhere than somebody said."""
    return [
        f"mount {mount.name} of unit {solution.table.units[mount.unit]}: mount_deg is {mount.nominal_deg:g}, "
        f"gravity says {mount.on_its_turn(float(angle_deg)):.1f}° about {face}"
        for mount, angle_deg, face in zip(
            solution.table.mounts, on_stage.mounts_deg, solution.of.faces, strict=True
        )
        if mount.nominal_deg is not None and abs(wrap_deg(float(angle_deg) - mount.nominal_deg)) > OFF_DEG
    ]


def _of_dial(solution: ThreeAxisSolution) -> list[str]:
    dial, said = solution.table.dial_deg[solution.fit.kept], []
    if not goes_round(dial):
        arc = TURN_DEG - widest_gap_deg(dial)
        said.append(f"the poses stand on {arc:.0f}° of the dial: the map is known there and nowhere else")
    return [*said, *of_untold_orders(solution.choice)]


@dataclass(frozen=True, slots=True, eq=False)
class WholeUnit:
    """What a solution says of one unit: its elevation, its accelerometer, its gyro."""

    plane: InPlane
    worth: ElevationUncertainty
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
        **uncertainty_document(worth),
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
