"""A unit's calibration as the document that flight software reads (CONTRACT section 6).

A document that is read from a file or a service is refused unless it is as it was issued.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.line import Line
from calrig.calibration.poses import Pose, of_first_mount
from calrig.calibration.results import FittedResult, angles_deg, readings_wrap
from calrig.calibration.separation import in_words
from calrig.calibration.uncertainty import reference_figures, uncertainty
from calrig.canonical_json import json_of_file, sha256_of
from calrig.errors import InputError, readable
from calrig.estimation.angles import FloatArray
from calrig.model.result import Reference
from calrig.store.records import AcceptedEffect, Document

SCHEMA = "calrig.calibration/2"
LARGEST = 10_000_000
"""Bytes; a document has some thousands."""
_NEEDED = ("unit", "range_deg", "bias_deg", "scale", "effects")


def read_document(source: str | Path) -> dict[str, Any]:
    """A document of CONTRACT section 6.

    `source` is a file, or an address such as `http://lab-pc:8000/api/units/AS-0042/calibration`, which is
    asked with the token of CALRIG_TOKEN.

    Raises:
        InputError: it cannot be read, is no such document, or its `sha256` is that of another.
        WorkError: the service refuses or cannot be reached.
    """
    name = str(source)
    is_address = name.startswith(("http://", "https://"))
    return checked(_from_service(name) if is_address else _from_file(Path(source)), name)


def checked(document: Any, name: str) -> dict[str, Any]:
    """The same of JSON that has been read; `name` says where it is from."""
    if not isinstance(document, dict) or not str(document.get("schema")).startswith("calrig.calibration/"):
        raise InputError(f"{name}: is no calibration: `calrig export --unit SERIAL` prints one")
    if document["schema"] != SCHEMA:
        raise InputError(f"{name}: is a {str(document['schema'])[:40]}, and what is known here is {SCHEMA}")
    try:
        is_as_issued = document.get("sha256") == sha256_of(document)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: holds what no calibration does ({error})") from error
    if not is_as_issued:
        raise InputError(f"{name}: was changed since it was issued: its sha256 is not that of what it says")
    missing = [key for key in _NEEDED if key not in document]
    if missing:
        raise InputError(f"{name}: lacks {', '.join(missing)}")
    return document


def _from_file(file: Path) -> Any:
    with readable(file), file.open("rb") as opened:
        content = opened.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise InputError(f"{file}: has more than {LARGEST} bytes, and no calibration has")
    return json_of_file(content, str(file), "a calibration")


def _from_service(address: str) -> Any:
    from calrig.client.transport import Transport

    try:
        parts = urlsplit(address)
    except ValueError as error:
        raise InputError(f"{address}: is no address ({error})") from error
    server = urlunsplit((parts.scheme, parts.netloc, "", "", ""))
    # what is issued has its hash in it, and may lie behind a link that lasts
    return Transport(server, follows=True).get(urlunsplit(("", "", parts.path or "/", parts.query, "")))


MODEL = "elevation = (reading − bias − effects)/scale"


def calibration_content(
    *,
    unit: str,
    rig: str | None,
    poses: Sequence[Pose],
    result: FittedResult,
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
        accepted: effects of the unit and its rig: bias and scale are those fitted with all of them, and the
            unit's own are applied in flight.
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
        "joint_covariance": _joint_covariance(line),
        "effects": [
            {"name": effect.name, "parameters": effect.parameters, "formula": effect_of(effect.name).formula}
            for effect in accepted
            if effect.unit is not None and result.line_with_effects is not None
        ],
        "readings_wrap": _wrap(poses, line.bias_deg, line.scale),
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
        "degrees_of_freedom": None if result.over_range is None else result.over_range.freedom,
    }


def _joint_covariance(line: Line) -> Document | None:
    """Return what the uncertainty of an elevation follows from; None where bias and scale are all."""
    if line.errors is None:
        return None
    effects = [f"effects[{k}].{name}" for k, name in line.errors.parameters]
    matrix = line.errors.steps.T @ line.errors.steps
    return {
        "parameters": ["bias_deg", "scale", *effects],
        "matrix": matrix.tolist(),
        "scatter_deg": line.residual_std_deg,
        "slope": line.slope or line.scale,
    }


def _wrap(poses: Sequence[Pose], bias_deg: float, scale: float | None) -> bool | None:
    """Return whether the readings start anew after a turn; None where the poses do not show it."""
    theta_deg, reading_deg = angles_deg(poses)
    return readings_wrap(reading_deg, bias_deg + (1.0 if scale is None else scale) * theta_deg)


def _by_map(
    elevations: FloatArray, line: Line, reference: Reference | None, provenance: Document
) -> dict[str, Any]:
    """Which map the uncertainty rests on; nothing where that is a certificate, which the provenance has."""
    if reference is None or reference.kind != "map":
        return {}
    kept = provenance["stage_map"]
    figures = reference_figures(elevations, line, reference).model_dump(mode="json")
    return {"reference": {**figures, "sha256": kept["sha256"], "says": in_words(kept)}}


def line_of(document: Mapping[str, Any]) -> Line:
    """Bias and scale of such a document, with their standard errors."""
    covariance = document["covariance"]
    stds = (None, None) if covariance is None else (covariance[0][0] ** 0.5, covariance[1][1] ** 0.5)
    return Line(
        bias_deg=float(document["bias_deg"]),
        scale=document["scale"],
        bias_std_deg=stds[0],
        scale_std=stds[1],
        covariance=None if covariance is None else (tuple(covariance[0]), tuple(covariance[1])),
        residual_std_deg=None,
    )
