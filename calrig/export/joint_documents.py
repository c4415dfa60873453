"""What a joint solution leaves behind: each unit's calibration (CONTRACT section 6), and the stage's map."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calrig.calibration.coverage import COVERAGE, coverage_factor
from calrig.calibration.effects import effect_of
from calrig.calibration.joint.elevation import range_deg
from calrig.calibration.joint.mapped import mapped
from calrig.calibration.joint.report import level_document, parameters_of
from calrig.calibration.joint.solution import Solution
from calrig.calibration.joint.unit_model import NAMES
from calrig.calibration.stage_reference import MAP_SCHEMA
from calrig.canonical_json import with_sha256
from calrig.estimation.angles import wrap_deg
from calrig.export.calibration_json import MODEL, SCHEMA
from calrig.export.joint_files import joint_files

_CURVATURES = ("y_mg_per_g2", "y_mg_per_g3", "z_mg_per_g2", "z_mg_per_g3")
EFFECTS: dict[str, tuple[str, ...]] = {
    "accelerometer_offset": ("y_mg", "z_mg"),
    "axis_mismatch": ("gain_pct", "skew_deg"),
    "axis_nonlinearity": (*_CURVATURES, "skew_deg"),
    "temperature_offset": ("y_mg_per_c", "z_mg_per_c", "reference_c"),
}
"""Of the catalogue, and their parameters among those of a unit."""
ADDED = {"y_mg", "z_mg", "y_mg_per_c", "z_mg_per_c", *_CURVATURES}
"""Added to a vector that is longer than 1 g by the common gain; in the catalogue's vector there is none."""


def joint_documents(solution: Solution, rig: str | None = None) -> dict[str, str]:
    """The files that a solution leaves behind, of runs on a rig or of files."""
    units = {serial: unit_document(solution, k, rig) for k, serial in enumerate(solution.table.units)}
    return joint_files(units, map_document(solution, rig))


def unit_document(solution: Solution, unit: int, rig: str | None = None) -> dict[str, Any]:
    """A unit's calibration with the uncertainty of this solution: nothing in it rests on the stage's word.

    All that the unit does to a vector is in its effects, beside a scale of 1; the bias is its level, where a
    reversal tells it, and 0 where none does: the sensor's axes err at their own elevation, which is bias + θ.
    `elevation_std_deg`
    is as in the solution's document; `covariance` is what of it a line over the range has.
    """
    fit, table, worth = solution.fit, solution.table, solution.measurand(unit)
    level = solution.known_level(unit)
    line = np.linalg.pinv(np.stack([np.ones(len(worth.elevation_deg)), worth.elevation_deg], axis=1))
    covariance = np.degrees(np.degrees(fit.covariance_of(line @ worth.by_parameters)))
    covariance[0, 0] += np.degrees(np.degrees(worth.common_variance))
    factor = coverage_factor(solution.noise_deg, fit.freedom, worth.rms_deg, "normal")
    own = (table.unit == unit) & fit.kept
    stated = np.array([mount.sense * (mount.nominal_deg or 0.0) for mount in table.mounts])[table.mount]
    raw = wrap_deg(np.degrees(table.reading) - table.sense * table.dial_deg - stated)[own]
    document = {
        "schema": SCHEMA,
        "unit": table.units[unit],
        "revision": None,
        "issued_at": None,
        "run_id": None,
        "calibrated_at": None,
        "rig": rig,
        "range_deg": list(range_deg(fit, unit)),
        "model": MODEL,
        "bias_deg": 0.0 if level is None else level.value_deg,
        "scale": 1.0,
        "covariance": covariance.tolist(),
        "effects": effects_of(solution, unit),
        "gyro": {"bias_dps": [None, None, None], "scale": None},
        "rms_raw_deg": _rms(raw),
        "rms_calibrated_deg": None,
        "rms_with_effects_deg": _rms(np.degrees(fit.left()[own])),
        "expanded_uncertainty_deg": factor * math.hypot(solution.noise_deg, worth.rms_deg),
        "coverage_factor": factor,
        "coverage": COVERAGE,
        "level_known": level is not None,
        "level_std_deg": None if level is None else level.std_deg,
        "accelerometer": None,
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
            "linear": fit.problem.linear,
            "separable": solution.is_separable(unit),
            "level": None if level is None else level_document(level),
        },
    }
    return with_sha256(document)


def effects_of(solution: Solution, unit: int) -> list[dict[str, Any]]:
    """A unit's parameters as effects of the catalogue, which has the common gain nowhere."""
    values = parameters_of(solution, unit)
    common = float(solution.fit.parameters[solution.fit.problem.unit_at(unit)][NAMES.index("common_gain")])
    numbers = {
        name: float(v["value"] or 0.0) / (1.0 + common if name in ADDED else 1.0)
        for name, v in values.items()
    }
    if solution.fit.problem.linear:
        numbers = {name: value for name, value in numbers.items() if name not in _CURVATURES}
    return [
        {
            "name": name,
            "parameters": {parameter: numbers[parameter] for parameter in parameters},
            "formula": effect_of(name).formula,
        }
        for name, parameters in EFFECTS.items()
        if all(parameter in numbers for parameter in parameters)
    ]


def map_document(solution: Solution, rig: str | None = None) -> dict[str, Any]:
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
        "separable": all(solution.is_separable(unit) for unit in range(len(solution.table.units))),
    }
    return with_sha256(document)


def _temperatures(solution: Solution, unit: int) -> dict[str, float] | None:
    reference = float(solution.table.reference_c[unit])
    if math.isnan(reference):
        return None
    own = solution.table.warmer_c[solution.table.unit == unit] + reference
    return {"min": float(own.min()), "max": float(own.max())}


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
