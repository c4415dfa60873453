"""A unit's calibration as the document that flight software reads (CONTRACT section 6)."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from calrig.calibration.correction import numbers_of
from calrig.calibration.effects import effect_of
from calrig.calibration.pose import Pose
from calrig.calibration.result import build_result
from calrig.calibration.uncertainty import uncertainty
from calrig.store.records import AcceptedEffect, Run, reference_of

SCHEMA = "calrig.calibration/1"
MODEL = "elevation = (reading − bias − effects)/scale"


def calibration_document(
    run: Run, poses: Sequence[Pose], accepted: Sequence[AcceptedEffect] = ()
) -> dict[str, Any]:
    """The document of a completed run whose scale is known.

    Args:
        run: as `Store.latest_calibration_run` gives it.
        poses: those the result rests on (none excluded): range and uncertainty follow from them.
        accepted: effects in force for the unit and its rig: bias and scale are those beside all of them, and
            the unit's own are applied in flight.

    Raises:
        ValueError: the run has no result, no scale, no poses, or has not finished.
    """
    result = run.result
    if result is None or result["scale"] is None or run.finished_at is None or not poses:
        raise ValueError(f"run {run.id} is not a finished calibration with a known scale")
    elevations = [pose.theta_deg for pose in poses]
    built = build_result(poses, effects=[(e.name, numbers_of(e.parameters)) for e in accepted])
    line = built.line_with_effects or built.line
    worth = uncertainty(line, np.array(elevations, dtype=np.float64), reference_of(run.provenance))
    gyro = result["gyro"]
    return {
        "schema": SCHEMA,
        "unit": run.unit,
        "run_id": run.id,
        "calibrated_at": iso_utc(run.finished_at),
        "rig": run.rig,
        "range_deg": [min(elevations), max(elevations)],
        "model": MODEL,
        "bias_deg": line.bias_deg,
        "scale": line.scale,
        "covariance": None if line.covariance is None else [list(row) for row in line.covariance],
        "effects": [
            {"name": effect.name, "parameters": effect.parameters, "formula": effect_of(effect.name).formula}
            for effect in accepted
            if effect.unit is not None and built.line_with_effects is not None
        ],
        "gyro": None if gyro is None else {"bias_dps": gyro["bias_dps"], "scale": gyro["scale"]},
        "rms_raw_deg": result["rms_raw_deg"],
        "rms_calibrated_deg": result["rms_calibrated_deg"],
        "rms_with_effects_deg": built.rms_with_effects_deg,
        "expanded_uncertainty_deg": worth.expanded_deg,
        "coverage_factor": worth.coverage_factor,
        "coverage": worth.coverage,
        "uncertainty": worth.to_dict(),
        "temperature_c": result["temperature_c"],
        "provenance": run.provenance,
    }


def iso_utc(time: datetime) -> str:
    """An aware time as ISO 8601 in UTC with a `Z`, as the API writes it."""
    return time.astimezone(UTC).isoformat().replace("+00:00", "Z")
