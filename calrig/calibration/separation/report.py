"""What documents of solutions in the plane and of whole units say alike (CONTRACT section 8).

The joint solution as CONTRACT section 8's document.

What each pose leaves of its angle, without the stage's map and with it: for pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from calrig.calibration.progress import Progress, unheard
from calrig.calibration.separation.held_out import HeldOut, believing_the_stage, held_out
from calrig.calibration.separation.least_squares import Fit
from calrig.calibration.separation.level import ElevationUncertainty, Level, polynomial
from calrig.calibration.separation.map_report import Mapped, mapped
from calrig.calibration.separation.messages import Advice, advised, sentences
from calrig.calibration.separation.solution import Solution
from calrig.calibration.separation.stage_map import basis
from calrig.calibration.separation.three_axis_fit import ThreeAxisFit
from calrig.calibration.separation.unit_model import CURVATURES, NAMES, PER_C
from calrig.estimation.angles import FloatArray

Value = dict[str, float | None]
UNITS = {
    "y": ("y_mg", 1e3),
    "z": ("z_mg", 1e3),
    "gain": ("gain_pct", 1e2),
    "skew": ("skew_deg", float(np.degrees(1.0))),
    "y2": ("y_mg_per_g2", 1e3),
    "y3": ("y_mg_per_g3", 1e3),
    "z2": ("z_mg_per_g2", 1e3),
    "z3": ("z_mg_per_g3", 1e3),
    "y_per_c": ("y_mg_per_c", 1e3),
    "z_per_c": ("z_mg_per_c", 1e3),
}
"""A document's names of the parameters, and their units."""


def value(number: float, std: float | None) -> Value:
    """A parameter with its standard error."""
    return {"value": float(number), "std": None if std is None else float(std)}


def projected(coefficients: FloatArray, covariance: FloatArray, linear: bool) -> dict[str, Value]:
    """Coefficients (2,) of a polynomial of the angle and covariance (2, 2), which is none of linear units."""
    stds = [None, None] if linear else np.sqrt(np.maximum(np.diag(covariance), 0.0))
    names = ("deg_per_deg2", "deg_per_deg3")
    return {name: value(c, s) for name, c, s in zip(names, coefficients, stds, strict=True)}


def uncertainty_document(worth: ElevationUncertainty) -> dict[str, Any]:
    """What a unit's elevation is worth, and where."""
    return {
        "range_deg": worth.elevation_deg[[0, -1]].tolist(),
        "elevation_std_deg": {
            "elevation_deg": worth.elevation_deg.tolist(),
            "std_deg": worth.std_deg.tolist(),
        },
    }


def stage_document(on_stage: Mapped) -> dict[str, Any]:
    """The stage's map, its harmonics and play."""
    return {
        "map": map_document(on_stage),
        "harmonics": [asdict(harmonic) for harmonic in on_stage.harmonics],
        "backlash_deg": None if on_stage.backlash is None else value(*on_stage.backlash),
    }


def map_document(on_stage: Mapped) -> dict[str, Any]:
    """The stage's error over its dial."""
    return {
        "stage_deg": on_stage.stage_deg.tolist(),
        "error_deg": on_stage.error_deg.tolist(),
        "std_deg": on_stage.std_deg.tolist(),
    }


def figures(fit: Fit | ThreeAxisFit, tested: HeldOut) -> dict[str, Any]:
    """The error of held-out poses before and after, and the noise."""
    return {
        "held_out": {"how": f"{tested.stretches} stretches of elevation", "n_poses": tested.n_poses},
        "before": {"held_out_rms_deg": tested.before_deg},
        "final": {"held_out_rms_deg": tested.final_deg},
        "noise": {
            "std_deg": float(np.degrees(fit.noise)),
            "lag1_correlation": fit.problem.correlation,
        },
    }


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
        **uncertainty_document(worth),
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


DECIMALS = 6
"""Of a degree: what is kept to be drawn need not be more."""


def pose_residuals(solution: Solution) -> dict[str, list[Any]]:
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
