"""A unit's calibration document: CONTRACT section 6's names, and arithmetic that gives the elevation back."""

from __future__ import annotations

import dataclasses
import json
from datetime import UTC, datetime

import pytest

from calrig.calibration.pose import Pose
from calrig.export.calibration_json import Uncertainty, calibration_document
from calrig.store import Run

RUN = Run(
    id="17",
    unit="AS-0042",
    rig="bench-1",
    status="completed",
    plan={"kind": "calibration"},
    progress={"poses_done": 2, "poses_total": 2, "fraction": 1.0, "remaining_s": 0.0},
    result={
        "bias_deg": 0.25,
        "bias_std_deg": 0.004,
        "scale": 1.002,
        "scale_std": 0.0001,
        "rms_raw_deg": 0.26,
        "rms_calibrated_deg": 0.03,
        "rms_with_effects_deg": None,
        "n_poses": 2,
        "noise_deg": 0.02,
        "temperature_c": {"min": 21.5, "max": 24.0},
        "gyro": {"bias_dps": [0.1, -0.2, 0.3], "scale": 1.001, "scale_std": 0.0002},
    },
    diagnosis=None,
    faults={},
    follows=None,
    provenance={"calrig": "0.1.0"},
    operator=None,
    note=None,
    voided=None,
    created_at=datetime(2026, 11, 20, 9, 0, tzinfo=UTC),
    started_at=datetime(2026, 11, 20, 9, 0, 1, tzinfo=UTC),
    finished_at=datetime(2026, 11, 20, 9, 3, 20, tzinfo=UTC),
    error=None,
)
POSES = [Pose(-60.0, -59.89, stage_deg=-60.02), Pose(60.0, 60.37)]
UNCERTAINTY = Uncertainty(
    covariance=((1.6e-5, 0.0), (0.0, 1e-8)),
    type_a_deg=0.004,
    type_b_deg=0.291,
    reference_deg=0.29,
    expanded_uncertainty_deg=0.582,
)


def test_the_document_has_the_contracts_names_and_is_json():
    document = calibration_document(RUN, POSES, UNCERTAINTY)
    assert json.loads(json.dumps(document, allow_nan=False)) == {
        "schema": "calrig.calibration/1",
        "unit": "AS-0042",
        "run_id": "17",
        "calibrated_at": "2026-11-20T09:03:20Z",
        "rig": "bench-1",
        "range_deg": [-60.02, 60.0],
        "model": "elevation = (reading − bias − effects)/scale",
        "bias_deg": 0.25,
        "scale": 1.002,
        "covariance": [[1.6e-5, 0.0], [0.0, 1e-8]],
        "effects": [],
        "gyro": {"bias_dps": [0.1, -0.2, 0.3], "scale": 1.001},
        "rms_raw_deg": 0.26,
        "rms_calibrated_deg": 0.03,
        "rms_with_effects_deg": None,
        "expanded_uncertainty_deg": 0.582,
        "coverage_factor": 2,
        "uncertainty": {"type_a_deg": 0.004, "type_b_deg": 0.291, "reference_deg": 0.29},
        "temperature_c": {"min": 21.5, "max": 24.0},
        "provenance": {"calrig": "0.1.0"},
    }


def test_applying_the_document_takes_a_reading_to_the_elevation():
    document = calibration_document(RUN, POSES, UNCERTAINTY)
    elevation_deg = (60.37 - document["bias_deg"]) / document["scale"]
    assert elevation_deg == pytest.approx(60.0, abs=1e-9)


@pytest.mark.parametrize(
    "change",
    [{"result": None}, {"result": {**RUN.result, "scale": None}}, {"finished_at": None}],
)
def test_a_run_without_a_known_scale_has_no_document(change):
    with pytest.raises(ValueError, match="run 17 is not a finished calibration"):
        calibration_document(dataclasses.replace(RUN, **change), POSES, UNCERTAINTY)
