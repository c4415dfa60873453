"""What a solution of whole units leaves behind: calibrations (CONTRACT section 6), and the stage's map.

As of units in their plane (`joint_documents`), with `accelerometer` and `gyro` filled: what an elevation
needs is in `effects`, what a vector needs in `accelerometer`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from calrig.calibration.coverage import COVERAGE, coverage_factor
from calrig.calibration.effects import effect_of
from calrig.calibration.joint.mapped import mapped
from calrig.calibration.joint.three_axis_frame import Frame
from calrig.calibration.joint.three_axis_report import (
    WholeUnit,
    accelerometer_document,
    gyro_document,
    plane_parameters,
    units_of,
)
from calrig.calibration.joint.three_axis_solution import ThreeAxisSolution
from calrig.calibration.stage_reference import MAP_SCHEMA
from calrig.canonical_json import with_sha256
from calrig.estimation.angles import wrap_deg
from calrig.export.calibration_json import MODEL, SCHEMA
from calrig.export.joint_documents import ADDED, EFFECTS

CURVED = "axis_nonlinearity"


def three_axis_documents(
    solution: ThreeAxisSolution, frame: Frame = "sensor", rig: str | None = None
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Calibrations by serial, and the map."""
    units = units_of(solution, frame)
    serials = solution.table.units
    calibrations = {serial: _calibration(solution, k, units[k], rig) for k, serial in enumerate(serials)}
    return calibrations, _map(solution, units, rig)


def _calibration(solution: ThreeAxisSolution, unit: int, found: WholeUnit, rig: str | None) -> dict[str, Any]:
    fit, table, worth = solution.fit, solution.table, found.worth
    line = np.linalg.pinv(np.stack([np.ones(len(worth.elevation_deg)), worth.elevation_deg], axis=1))
    by_line = np.degrees(line @ worth.by_parameters)
    factor = coverage_factor(solution.noise_deg, fit.freedom, worth.rms_deg, "normal")
    own = (table.unit == unit) & fit.kept
    stated = np.array([mount.nominal_deg or 0.0 for mount in table.mounts])[table.mount]
    raw_deg = wrap_deg(np.degrees(table.angle()) - table.dial_deg - stated)[own]
    document = {
        "schema": SCHEMA,
        "unit": table.units[unit],
        "revision": None,
        "issued_at": None,
        "run_id": None,
        "calibrated_at": None,
        "rig": rig,
        "range_deg": [float(worth.elevation_deg[0]), float(worth.elevation_deg[-1])],
        "model": MODEL,
        "bias_deg": 0.0,
        "scale": 1.0,
        "covariance": (by_line @ fit.covariance @ by_line.T).tolist(),
        "effects": _effects(solution, unit, found),
        "gyro": _gyro(found),
        "rms_raw_deg": _rms(raw_deg),
        "rms_calibrated_deg": None,
        "rms_with_effects_deg": _rms(np.degrees(fit.left()[own])),
        "expanded_uncertainty_deg": factor * math.hypot(solution.noise_deg, worth.rms_deg),
        "coverage_factor": factor,
        "coverage": COVERAGE,
        "level_known": False,
        "level_std_deg": None,
        "accelerometer": accelerometer_document(found.accelerometer),
        "uncertainty": {
            "type_a_deg": solution.noise_deg,
            "type_b_deg": worth.rms_deg,
            "reference_deg": worth.rms_deg,
        },
        "elevation_std_deg": {
            "elevation_deg": worth.elevation_deg.tolist(),
            "std_deg": worth.std_deg.tolist(),
        },
        "temperature_c": _temperatures(solution, unit),
        "provenance": {
            "solved_from": list(table.sources),
            "units": list(table.units),
            "faces": sorted(set(solution.of.faces)),
            "linear": fit.problem.linear,
            "separable": worth.rms_deg < solution.noise_deg,
        },
    }
    return with_sha256(document)


def _effects(solution: ThreeAxisSolution, unit: int, found: WholeUnit) -> list[dict[str, Any]]:
    """The unit about its x axis as effects of the catalogue, whose vector is 1 g long."""
    size = 1.0 + float(found.plane.own[0])
    values = plane_parameters(solution, unit, found.plane)
    numbers = {
        name: float(v["value"] or 0.0) / (size if name in ADDED else 1.0) for name, v in values.items()
    }
    return [
        {
            "name": name,
            "parameters": {parameter: numbers[parameter] for parameter in parameters},
            "formula": effect_of(name).formula,
        }
        for name, parameters in EFFECTS.items()
        if all(parameter in numbers for parameter in parameters)
        and not (name == CURVED and solution.fit.problem.linear)
    ]


def _gyro(found: WholeUnit) -> dict[str, Any]:
    """As section 8 has it, with the scale about x that section 6 has."""
    stated = gyro_document(found.gyro) or {"bias_dps": None}
    matrix = stated.get("matrix")
    bias = stated["bias_dps"] or [None, None, None]
    return {**stated, "bias_dps": bias, "scale": None if matrix is None else matrix[0][0]}


def _map(solution: ThreeAxisSolution, units: Sequence[WholeUnit], rig: str | None) -> dict[str, Any]:
    """The stage's map: over its dial, and as the series itself with its covariance."""
    on_stage = mapped(solution.fit)
    document = {
        "schema": MAP_SCHEMA,
        "rig": rig,
        "model": "error = Σ (cos_k·cos kψ + sin_k·sin kψ) + backlash/2·approach, ψ the dial's angle",
        "orders": list(solution.fit.problem.orders),
        "coefficients_deg": on_stage.coefficients.tolist(),
        "covariance_deg2": on_stage.covariance.tolist(),
        "map": {
            "stage_deg": on_stage.stage_deg.tolist(),
            "error_deg": on_stage.error_deg.tolist(),
            "std_deg": on_stage.std_deg.tolist(),
        },
        "units": list(solution.table.units),
        "solved_from": list(solution.table.sources),
        "separable": all(unit.worth.rms_deg < solution.noise_deg for unit in units),
    }
    return with_sha256(document)


def _temperatures(solution: ThreeAxisSolution, unit: int) -> dict[str, float] | None:
    reference = float(solution.table.reference_c[unit])
    if math.isnan(reference):
        return None
    own = solution.table.warmer_c[solution.table.unit == unit] + reference
    return {"min": float(own.min()), "max": float(own.max())}


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
