"""What documents of a joint solution have in common, of units in their plane and of whole ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.line import rms
from calrig.calibration.separation import (
    MAP_SCHEMA,
    ElevationUncertainty,
    Solution,
    Table,
    ThreeAxisSolution,
    Value,
    map_document,
    mapped,
    uncertainty_document,
)
from calrig.calibration.uncertainty import COVERAGE, coverage_factor
from calrig.canonical_json import with_sha256
from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.export.calibration_file import SCHEMA
from calrig.export.calibration_json import MODEL

Solved = Solution | ThreeAxisSolution

CURVED = "axis_nonlinearity"
_CURVATURES = ("y_mg_per_g2", "y_mg_per_g3", "z_mg_per_g2", "z_mg_per_g3")
_EFFECTS: dict[str, tuple[str, ...]] = {
    "accelerometer_offset": ("y_mg", "z_mg"),
    "axis_mismatch": ("gain_pct", "skew_deg"),
    CURVED: (*_CURVATURES, "skew_deg"),
    "temperature_offset": ("y_mg_per_c", "z_mg_per_c", "reference_c"),
}
"""Of the catalogue, and their parameters among those of a unit."""
_ADDED = {"y_mg", "z_mg", "y_mg_per_c", "z_mg_per_c", *_CURVATURES}
"""Added to a vector that is longer than 1 g by the common gain; in the catalogue's vector there is none."""


def calibration(
    solution: Solved,
    unit: int,
    worth: ElevationUncertainty,
    own: Mapping[str, Any],
    provenance: Mapping[str, Any],
    rig: str | None,
) -> dict[str, Any]:
    """A unit's calibration (CONTRACT section 6).

    Args:
        solution: of it and others.
        unit: by index.
        worth: of its elevation; `covariance` is what of that a line over the range has.
        own: of its keys those that are not as here: effects, and level, gyro or accelerometer where known.
        provenance: beside what is said of any.
        rig: that the runs were on; None of files.
    """
    fit, table, uncertainty_deg = solution.fit, solution.table, worth.rms_deg
    factor = coverage_factor(solution.noise_deg, fit.freedom, uncertainty_deg, "normal")
    of_unit = (table.unit == unit) & fit.kept
    document = {
        "schema": SCHEMA,
        "unit": table.units[unit],
        "revision": None,
        "issued_at": None,
        "run_id": None,
        "calibrated_at": None,
        "rig": rig,
        **uncertainty_document(worth),
        "model": MODEL,
        "bias_deg": 0.0,
        "scale": 1.0,
        "covariance": _covariance(solution, worth).tolist(),
        "effects": [],
        "gyro": {"bias_dps": [None, None, None], "scale": None},
        "rms_raw_deg": rms(_raw_deg(table)[of_unit]),
        "rms_calibrated_deg": None,
        "rms_with_effects_deg": rms(np.degrees(fit.left()[of_unit])),
        "expanded_uncertainty_deg": factor * math.hypot(solution.noise_deg, uncertainty_deg),
        "coverage_factor": factor,
        "coverage": COVERAGE,
        "level_known": False,
        "level_std_deg": None,
        "accelerometer": None,
        "uncertainty": {
            "type_a_deg": solution.noise_deg,
            "type_b_deg": uncertainty_deg,
            "reference_deg": uncertainty_deg,
        },
        "temperature_c": _temperatures(table, unit),
        "provenance": {
            "solved_from": list(table.sources),
            "units": list(table.units),
            "linear": fit.problem.linear,
            "degrees_of_freedom": fit.freedom,
            **provenance,
        },
    }
    return with_sha256({**document, **own})


def effects_of_values(values: Mapping[str, Value], size: float, linear: bool) -> list[dict[str, Any]]:
    """A unit's parameters as effects of the catalogue, whose vector is 1 g long.

    Args:
        values: as the solution's document has them.
        size: of the vector that was solved for, g.
        linear: whether the unit was stated to be.
    """
    numbers = {
        name: float(v["value"] or 0.0) / (size if name in _ADDED else 1.0) for name, v in values.items()
    }
    return [
        {
            "name": name,
            "parameters": {parameter: numbers[parameter] for parameter in parameters},
            "formula": effect_of(name).formula,
        }
        for name, parameters in _EFFECTS.items()
        if all(parameter in numbers for parameter in parameters) and not (name == CURVED and linear)
    ]


def stage_map(solution: Solved, separable: bool, rig: str | None) -> dict[str, Any]:
    """The stage's map: over its dial, and as the series itself with its covariance."""
    on_stage = mapped(solution.fit)
    document = {
        "schema": MAP_SCHEMA,
        "rig": rig,
        "model": "error = Σ (cos_k·cos kψ + sin_k·sin kψ) + backlash/2·approach, ψ the dial's angle",
        "orders": list(solution.fit.problem.orders),
        "coefficients_deg": on_stage.coefficients.tolist(),
        "covariance_deg2": on_stage.covariance.tolist(),
        "map": map_document(on_stage),
        "units": list(solution.table.units),
        "solved_from": list(solution.table.sources),
        "separable": separable,
    }
    return with_sha256(document)


def _covariance(solution: Solved, worth: ElevationUncertainty) -> FloatArray:
    """(2, 2) of bias and scale: of the line through errors of the elevation over the range."""
    line = np.linalg.pinv(np.stack([np.ones(len(worth.elevation_deg)), worth.elevation_deg], axis=1))
    covariance = solution.fit.covariance_of(line @ worth.by_parameters)
    covariance[0, 0] += worth.common_variance
    return np.asarray(np.degrees(np.degrees(covariance)))


def _raw_deg(table: Table) -> FloatArray:
    """(n,) what each pose reads less the elevation that stage and mount were said to have."""
    mounted_deg: FloatArray = np.array([mount.nominal_deg or 0.0 for mount in table.mounts])[table.mount]
    return wrap_deg(np.degrees(table.reading) - table.sense * (table.dial_deg + mounted_deg))


def _temperatures(table: Table, unit: int) -> dict[str, float] | None:
    reference = float(table.reference_c[unit])
    if math.isnan(reference):
        return None
    own = table.warmer_c[table.unit == unit] + reference
    return {"min": float(own.min()), "max": float(own.max())}
