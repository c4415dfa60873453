"""The joint solution as CONTRACT section 8's document."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calrig.calibration.joint.advice import Advice, advised
from calrig.calibration.joint.elevation import polynomial
from calrig.calibration.joint.held_out import HeldOut, held_out
from calrig.calibration.joint.level import Level
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
from calrig.calibration.joint.said import sentences
from calrig.calibration.joint.solution import Solution
from calrig.calibration.joint.unit_model import CURVATURES, NAMES, PER_C
from calrig.calibration.progress import Progress, unheard


def solution_document(
    solution: Solution,
    limits_deg: tuple[float, float] | None = None,
    progress: Progress = unheard,
) -> dict[str, Any]:
    """Everything that was solved for, what it is worth, and what would help within limits of the dial."""
    on_stage, tested = mapped(solution.fit), held_out(solution.fit, progress)
    advice = advised(solution, limits_deg)
    units = range(len(solution.table.units))
    return {
        "units": [_unit(solution, unit) for unit in units],
        "stage": stage_document(on_stage),
        "mounts": _mounts(solution, on_stage),
        "separable": all(solution.is_separable(unit) for unit in units),
        "advice": None if advice is None else _advice(advice),
        **figures(solution.fit, tested),
        **_levels(solution),
        "warnings": [*solution.warnings, *sentences(solution, on_stage), *_of_held_out(tested)],
    }


def parameters_of(solution: Solution, unit: int) -> dict[str, Value]:
    """A unit's parameters in the units of documents; those of temperature where the data carry them."""
    fit, at = solution.fit, solution.fit.problem.unit_at(unit)
    values, stds = fit.parameters[at], fit.noise * np.sqrt(np.maximum(fit.inverse.diagonal()[at], 0.0))
    free = fit.problem.free[at]
    found: dict[str, Value] = {}
    for name, (stated_as, factor) in UNITS.items():
        k = NAMES.index(name)
        if free[k] or k in CURVATURES:
            found[stated_as] = value(factor * values[k], factor * stds[k] if free[k] else None)
    if free[PER_C[0]]:
        found["reference_c"] = value(float(solution.table.reference_c[unit]), None)
    return found


def _unit(solution: Solution, unit: int) -> dict[str, Any]:
    coefficients, covariance = polynomial(solution.fit, unit)
    worth, level = solution.measurand(unit), solution.levels[unit]
    return {
        "unit": solution.table.units[unit],
        "parameters": {
            **parameters_of(solution, unit),
            **projected(coefficients, covariance, solution.fit.problem.linear),
        },
        "accelerometer": None,
        "gyro": None,
        **worth_document(worth),
        "level": None if level is None else level_document(level),
    }


def level_document(level: Level) -> dict[str, Any]:
    """The angle of the sensor in its case, and what its standard error rests on."""
    return {
        "deg": value(level.value_deg, level.std_deg),
        "reversals": level.reversals,
        "seat_std_deg": level.seat_std_deg,
        "seat_from": level.seat_from,
    }


def _levels(solution: Solution) -> dict[str, Any]:
    """Whether the level of every unit is known, and of all of them the worst."""
    levels = [solution.known_level(unit) for unit in range(len(solution.table.units))]
    stds = [level.std_deg for level in levels if level is not None and level.std_deg is not None]
    known = len(stds) == len(levels)
    return {"level_known": known, "level_std_deg": max(stds) if known else None}


def _mounts(solution: Solution, on_stage: Mapped) -> list[dict[str, Any]]:
    fits = {test.mount: test.p_value for test in solution.mount_tests}
    return [
        {
            "mount": mount.name,
            "unit": solution.table.units[mount.unit],
            "mount_deg": mount.nominal_deg or 0.0,
            "mount_axis": mount.axis,
            "angle_deg": value(mount.on_its_turn(mount.sense * float(angle)), float(std)),
            "fits_p_value": fits.get(k),
        }
        for k, (mount, angle, std) in enumerate(
            zip(solution.table.mounts, on_stage.mounts_deg, on_stage.mounts_std_deg, strict=True)
        )
    ]


def _advice(advice: Advice) -> dict[str, Any]:
    return {
        "mounts_deg": list(advice.mounts_deg),
        "elevation_std_deg_now": advice.now_deg,
        "elevation_std_deg_then": advice.then_deg,
        "says": advice.says,
    }


def _of_held_out(tested: HeldOut) -> Sequence[str]:
    if tested.final_deg < tested.before_deg:
        return ()
    return ("held-out poses are predicted no better with the map than without it",)
