"""What documents of a joint solution have in common, of units in their plane and of whole ones.

What a joint solution leaves behind: each unit's calibration (CONTRACT section 6), and the stage's map.

What a solution of whole units leaves behind: calibrations (CONTRACT section 6), and the stage's map.

As of units in their plane (`joint_documents`), with `accelerometer` and `gyro` filled: what an elevation
needs is in `effects`, what a vector needs in `accelerometer`.

The documents of a joint solution as files.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.line import rms
from calrig.calibration.separation import (
    MAP_SCHEMA,
    NAMES,
    ElevationUncertainty,
    Frame,
    Solution,
    Table,
    ThreeAxisSolution,
    Value,
    WholeUnit,
    accelerometer_document,
    gyro_document,
    level_document,
    map_document,
    mapped,
    parameters_of,
    plane_parameters,
    uncertainty_document,
    units_of,
)
from calrig.calibration.uncertainty import COVERAGE, coverage_factor
from calrig.canonical_json import with_sha256
from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.export.calibration_document import MODEL, SCHEMA

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


def unit_document(solution: Solution, unit: int, rig: str | None = None) -> dict[str, Any]:
    """A unit's calibration with the uncertainty of this solution: nothing in it rests on the stage's word.

    All that the unit does to a vector is in its effects, beside a scale of 1; the bias is its level, where a
    reversal tells it, and 0 where none does: the sensor's axes err at their own elevation, which is bias + θ.
    """
    level = solution.known_level(unit)
    own = {
        "bias_deg": 0.0 if level is None else level.value_deg,
        "effects": effects_of(solution, unit),
        "level_known": level is not None,
        "level_std_deg": None if level is None else level.std_deg,
    }
    provenance = {
        "separable": solution.is_separable(unit),
        "level": None if level is None else level_document(level),
    }
    return calibration(solution, unit, solution.measurand(unit), own, provenance, rig)


def effects_of(solution: Solution, unit: int) -> list[dict[str, Any]]:
    """A unit's parameters as effects of the catalogue, which has the common gain nowhere."""
    problem = solution.fit.problem
    common = float(solution.fit.parameters[problem.unit_at(unit)][NAMES.index("common_gain")])
    return effects_of_values(parameters_of(solution, unit), 1.0 + common, problem.linear)


def stage_map_document(solution: Solution, rig: str | None = None) -> dict[str, Any]:
    """The stage's map."""
    separable = all(solution.is_separable(unit) for unit in range(len(solution.table.units)))
    return stage_map(solution, separable, rig)


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


def joint_files(calibrations: Mapping[str, dict[str, Any]], stage_map: dict[str, Any]) -> dict[str, str]:
    """The files' texts by their names; those of a unit's serial, with what no file is called by replaced.

    Args:
        calibrations: `unit_document` of each unit, by serial.
        stage_map: `map_document`.
    """
    named = {_file_name(serial): document for serial, document in calibrations.items()}
    return {name: in_file(document) for name, document in {**named, "stage-map.json": stage_map}.items()}


def in_file(document: dict[str, Any]) -> str:
    """A document as its file has it."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _file_name(serial: str) -> str:
    return re.sub(r"[^\w.\-]", "_", serial).lstrip(".") + ".json"
