"""The documents of a joint solution: each unit's calibration (CONTRACT section 6), and the stage map.

For a whole unit `accelerometer` and `gyro` are filled: an elevation needs `effects`, a vector needs
`accelerometer`.
"""

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
    ElevationUncertainty,
    Solution,
    Table,
    WholeUnit,
    accelerometer_document,
    gyro_document,
    level_document,
    local_document,
    map_document,
    mapped,
    parameters_of,
    uncertainty_document,
    whole_units,
)
from calrig.calibration.uncertainty import COVERAGE, coverage_factor
from calrig.canonical_json import with_sha256
from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.export.calibration_document import MODEL, SCHEMA
from calrig.model.solution import Frame

CURVED = "axis_nonlinearity"
_CURVATURES = ("y_mg_per_g2", "y_mg_per_g3", "z_mg_per_g2", "z_mg_per_g3")
_EFFECTS: dict[str, tuple[str, ...]] = {
    "accelerometer_offset": ("y_mg", "z_mg"),
    "axis_mismatch": ("gain_pct", "skew_deg"),
    CURVED: (*_CURVATURES, "skew_deg"),
    "temperature_offset": ("y_mg_per_c", "z_mg_per_c", "reference_c"),
}
"""Of the catalogue, and their parameters among those of a unit."""
_QUARTIC = ("y_mg_per_g4", "z_mg_per_g4")
"""Of `CURVED` as well, where the poses show them."""
_ADDED = {"y_mg", "z_mg", "y_mg_per_c", "z_mg_per_c", *_CURVATURES, *_QUARTIC}
"""Added to a vector that is longer than 1 g by the common gain; in the catalogue's vector there is none."""


def unit_documents(
    solution: Solution, frame: Frame = "sensor", rig: str | None = None
) -> dict[str, dict[str, Any]]:
    """Return the calibration of every unit by its serial, matrices in the frame asked for."""
    units = zip(solution.table.units, whole_units(solution, frame), strict=True)
    return {serial: unit_document(solution, k, rig, whole) for k, (serial, whole) in enumerate(units)}


def unit_document(
    solution: Solution, unit: int, rig: str | None = None, whole: WholeUnit | None = None
) -> dict[str, Any]:
    """Return a unit's calibration with the uncertainty of this solution: it rests on no report of the stage.

    All that the unit does to a vector is in its effects, with a scale of 1; the bias is its level, where a
    reversal shows it, and 0 where none does: the sensor's axes err at their own elevation, which is bias + θ.

    `unit` is by index; `rig` is that of the runs, None of files. `whole` are its matrices, of a unit that was
    clamped by several faces.
    """
    fit, table, level = solution.fit, solution.table, solution.known_level(unit)
    known = solution.measurand(unit)
    uncertainty_deg = known.rms_deg
    factor = coverage_factor(solution.noise_deg, fit.freedom, uncertainty_deg, "normal")
    of_unit = (table.unit == unit) & fit.kept
    only_whole = {"faces": sorted({mount.axis for mount in table.mounts})}
    only_plane = {"level": None if level is None else level_document(level)}
    return with_sha256(
        {
            "schema": SCHEMA,
            "unit": table.units[unit],
            "revision": None,
            "issued_at": None,
            "run_id": None,
            "calibrated_at": None,
            "rig": rig,
            **uncertainty_document(known),
            "model": MODEL,
            "bias_deg": 0.0 if level is None else level.value_deg,
            "scale": 1.0,
            "covariance": _covariance(solution, known).tolist(),
            "effects": effects_of(solution, unit),
            "readings_wrap": None,
            "gyro": _gyro(whole),
            "rms_raw_deg": rms(_raw_deg(table)[of_unit]),
            "rms_calibrated_deg": None,
            "rms_with_effects_deg": rms(np.degrees(fit.left()[of_unit])),
            "expanded_uncertainty_deg": factor * math.hypot(solution.noise_deg, uncertainty_deg),
            "coverage_factor": factor,
            "coverage": COVERAGE,
            "level_known": level is not None,
            "level_std_deg": None if level is None else level.std_deg,
            "accelerometer": None if whole is None else accelerometer_document(whole.accelerometer),
            "uncertainty": {
                "type_a_deg": solution.noise_deg,
                "type_b_deg": uncertainty_deg,
                "reference_deg": uncertainty_deg,
            },
            "temperature_c": _temperatures(table, unit),
            "degrees_of_freedom": fit.freedom,
            "provenance": {
                "solved_from": list(table.sources),
                "units": list(table.units),
                "linear": fit.problem.linear,
                "degrees_of_freedom": fit.freedom,
                "separable": solution.is_separable(unit),
                **(only_whole if table.is_whole else only_plane),
            },
        }
    )


def effects_of(solution: Solution, unit: int) -> list[dict[str, Any]]:
    """Return a unit's parameters as effects of the catalogue, whose vector is 1 g long."""
    size_g, linear = 1.0 + float(solution.planes[unit].own[0]), solution.fit.problem.linear
    numbers = {
        name: float(v["value"] or 0.0) / (size_g if name in _ADDED else 1.0)
        for name, v in parameters_of(solution, unit).items()
    }
    return [
        {
            "name": name,
            "parameters": {
                parameter: numbers[parameter]
                for parameter in (*parameters, *(_QUARTIC if name == CURVED else ()))
                if parameter in numbers
            },
            "formula": effect_of(name).formula,
        }
        for name, parameters in _EFFECTS.items()
        if all(parameter in numbers for parameter in parameters) and not (name == CURVED and linear)
    ]


def stage_map_document(solution: Solution, rig: str | None = None) -> dict[str, Any]:
    """Return the stage's map: over its dial, and as the series itself with its covariance."""
    on_stage = mapped(solution)
    document = {
        "schema": MAP_SCHEMA,
        "rig": rig,
        "model": "error = Σ (cos_k·cos kψ + sin_k·sin kψ) + backlash/2·approach, ψ the dial's angle",
        "orders": list(on_stage.orders),
        "coefficients_deg": on_stage.coefficients.tolist(),
        "covariance_deg2": on_stage.covariance.tolist(),
        "map": map_document(on_stage),
        **local_document(on_stage.regions, on_stage.gaps_deg),
        "units": list(solution.table.units),
        "solved_from": list(solution.table.sources),
        "separable": solution.are_separable,
    }
    return with_sha256(document)


def _covariance(solution: Solution, known: ElevationUncertainty) -> FloatArray:
    """(2, 2) of bias and scale: of the line through errors of the elevation over the range."""
    line = np.linalg.pinv(np.stack([np.ones(len(known.elevation_deg)), known.elevation_deg], axis=1))
    covariance = solution.fit.covariance_of(line @ known.by_parameters)
    covariance[0, 0] += known.common_variance
    return np.asarray(np.degrees(np.degrees(covariance)))


def _raw_deg(table: Table) -> FloatArray:
    """(n,) what each pose reads less the elevation that stage and mount were said to have."""
    mounted_deg: FloatArray = np.array([mount.nominal_deg or 0.0 for mount in table.mounts])[table.mount]
    return wrap_deg(np.degrees(table.reading) - table.dial_deg - mounted_deg)


def _temperatures(table: Table, unit: int) -> dict[str, float] | None:
    reference = float(table.reference_c[unit])
    if math.isnan(reference):
        return None
    own = table.warmer_c[table.unit == unit] + reference
    return {"min": float(own.min()), "max": float(own.max())}


def _gyro(whole: WholeUnit | None) -> dict[str, Any]:
    """As section 8 has it, with the scale about x that section 6 has."""
    stated = (whole and gyro_document(whole.gyro)) or {"bias_dps": None}
    matrix = stated.get("matrix")
    bias = stated["bias_dps"] or [None, None, None]
    return {**stated, "bias_dps": bias, "scale": None if matrix is None else matrix[0][0]}


def joint_files(calibrations: Mapping[str, dict[str, Any]], stage_map: dict[str, Any]) -> dict[str, str]:
    """The files' texts by their names; those of a unit's serial, with what no file is called by replaced.

    `calibrations` are the `unit_document` of each unit by serial, `stage_map` is `map_document`.
    """
    named = {re.sub(r"[^\w.\-]", "_", one).lstrip(".") + ".json": calibrations[one] for one in calibrations}
    return {name: in_file(document) for name, document in {**named, "stage-map.json": stage_map}.items()}


def in_file(document: dict[str, Any]) -> str:
    """A document as its file has it."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
