"""A unit's calibration as the document that flight software reads (CONTRACT section 6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.line import Line
from calrig.calibration.poses import Pose, of_first_mount
from calrig.calibration.results import Result
from calrig.calibration.separation import in_words
from calrig.calibration.uncertainty import Reference, ReferenceFigures, uncertainty
from calrig.estimation.angles import FloatArray
from calrig.export.calibration_file import SCHEMA
from calrig.store.records import AcceptedEffect, Document

MODEL = "elevation = (reading − bias − effects)/scale"


def calibration_content(
    *,
    unit: str,
    rig: str | None,
    poses: Sequence[Pose],
    result: Result,
    accepted: Sequence[AcceptedEffect] = (),
    reference: Reference | None = None,
    provenance: Document | None = None,
) -> Document:
    """What a revision says of a unit; the store adds which revision it is, of which run, and the hash.

    Args:
        unit: serial number.
        rig: that the poses were taken on; None where none is known.
        poses: those that count: range and uncertainty follow from those that the result rests on.
        result: of these poses, with the accepted effects taken out where the poses allow it.
        accepted: effects of the unit and its rig: bias and scale are those beside all of them, and the unit's
            own are applied in flight.
        reference: what the rig said of its stage when the poses were measured.
        provenance: of their run, which names the stage's map where the reference is one.

    Raises:
        ValueError: there is no pose, or the scale is not known.
    """
    if not poses or result.scale is None:
        raise ValueError(f"unit {unit!r}: the poses do not give a calibration with a known scale")
    elevations = np.array([pose.theta_deg for pose in of_first_mount(poses)], dtype=np.float64)
    line = result.line_with_effects or result.line
    worth = uncertainty(line, elevations, reference)
    figures = result.to_dict()
    gyro = figures["gyro"]
    return {
        "schema": SCHEMA,
        "unit": unit,
        "rig": rig,
        "range_deg": [float(elevations.min()), float(elevations.max())],
        "model": MODEL,
        "bias_deg": line.bias_deg,
        "scale": line.scale,
        "covariance": None if line.covariance is None else [list(row) for row in line.covariance],
        "effects": [
            {"name": effect.name, "parameters": effect.parameters, "formula": effect_of(effect.name).formula}
            for effect in accepted
            if effect.unit is not None and result.line_with_effects is not None
        ],
        "gyro": {"bias_dps": gyro["bias_dps"], "scale": gyro["scale"]},
        "rms_raw_deg": result.rms_raw_deg,
        "rms_calibrated_deg": result.rms_calibrated_deg,
        "rms_with_effects_deg": result.rms_with_effects_deg,
        "expanded_uncertainty_deg": worth.expanded_deg,
        "coverage_factor": worth.coverage_factor,
        "coverage": worth.coverage,
        "level_known": False,
        "level_std_deg": None,
        "accelerometer": None,
        "uncertainty": {**worth.to_dict(), **_by_map(elevations, line, reference, provenance or {})},
        "temperature_c": figures["temperature_c"],
    }


def _by_map(
    elevations: FloatArray, line: Line, reference: Reference | None, provenance: Document
) -> dict[str, Any]:
    """Which map the uncertainty rests on; nothing where that is a certificate, which the provenance has."""
    if reference is None or reference.kind != "map":
        return {}
    kept = provenance["stage_map"]
    figures = asdict(ReferenceFigures.of(elevations, line, reference))
    return {"reference": {**figures, "sha256": kept["sha256"], "says": in_words(kept)}}


def line_of(document: Mapping[str, Any]) -> Line:
    """Bias and scale of such a document, with their standard errors."""
    covariance = document["covariance"]
    stds = (None, None) if covariance is None else (covariance[0][0] ** 0.5, covariance[1][1] ** 0.5)
    return Line(
        bias_deg=document["bias_deg"],
        scale=document["scale"],
        bias_std_deg=stds[0],
        scale_std=stds[1],
        covariance=None if covariance is None else (tuple(covariance[0]), tuple(covariance[1])),
        residual_std_deg=None,
    )
