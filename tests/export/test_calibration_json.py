"""A unit's calibration document: CONTRACT section 6's names, and arithmetic that gives the elevation back."""

from __future__ import annotations

import dataclasses
import json
import math
from datetime import UTC, datetime

import numpy as np
import pytest

from calrig.calibration.pose import Pose
from calrig.export.calibration_json import calibration_document
from calrig.store import AcceptedEffect, Run

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
RESIDUALS_DEG = (0.01, -0.02, 0.0, 0.02, -0.01)
POSES = [
    Pose(target, 0.25 + 1.002 * target + residual)
    for target, residual in zip((-60.0, -30.0, 0.0, 30.0, 60.0), RESIDUALS_DEG, strict=True)
]
ON_A_STAGE = {"calrig": "0.1.0", "rig": {"name": "bench-1", "reference": {"std_deg": 0.29}}}


def test_the_document_has_the_contracts_names_and_is_json():
    document = json.loads(json.dumps(calibration_document(RUN, POSES), allow_nan=False))
    assert document == {
        "schema": "calrig.calibration/1",
        "unit": "AS-0042",
        "run_id": "17",
        "calibrated_at": "2026-11-20T09:03:20Z",
        "rig": "bench-1",
        "range_deg": [-60.0, 60.0],
        "model": "elevation = (reading − bias − effects)/scale",
        "bias_deg": 0.25,
        "scale": 1.002,
        "covariance": document["covariance"],
        "effects": [],
        "gyro": {"bias_dps": [0.1, -0.2, 0.3], "scale": 1.001},
        "rms_raw_deg": 0.26,
        "rms_calibrated_deg": 0.03,
        "rms_with_effects_deg": None,
        "expanded_uncertainty_deg": None,
        "coverage_factor": None,
        "coverage": 0.95,
        "uncertainty": {
            "type_a_deg": document["uncertainty"]["type_a_deg"],
            "type_b_deg": None,
            "reference_deg": None,
            "reference_bias_deg": None,
            "reference_scale": None,
        },
        "temperature_c": {"min": 21.5, "max": 24.0},
        "provenance": {"calrig": "0.1.0"},
    }


def test_its_covariance_is_that_of_the_least_squares_line():
    theta = np.array([pose.target_deg for pose in POSES])
    _, expected = np.polyfit(theta, [pose.reading_deg for pose in POSES], 1, cov=True)
    document = calibration_document(RUN, POSES)
    np.testing.assert_allclose(document["covariance"], expected[::-1, ::-1], rtol=1e-9, atol=1e-18)


def test_what_the_stage_is_worth_enters_whole_however_many_poses_there_are():
    for poses in (POSES, POSES * 40):
        document = calibration_document(dataclasses.replace(RUN, provenance=ON_A_STAGE), poses)
        parts = document["uncertainty"]
        assert parts["reference_deg"] == parts["type_b_deg"] == 0.29
        assert document["expanded_uncertainty_deg"] == pytest.approx(
            document["coverage_factor"] * math.hypot(parts["type_a_deg"], 0.29)
        )
        assert document["coverage_factor"] == pytest.approx(1.65, abs=0.01)


def test_the_stages_part_of_bias_and_scale_is_told_apart():
    """All poses off by one unknown constant: the bias takes it whole, times the scale; the scale nothing."""
    stage = {"std_deg": 0.29, "kind": "common"}
    run = dataclasses.replace(RUN, provenance={"rig": {"reference": stage}})
    parts = calibration_document(run, POSES)["uncertainty"]
    assert parts["reference_bias_deg"] == pytest.approx(0.29 * 1.002)
    assert parts["reference_scale"] == 0.0


def test_applying_the_document_takes_a_reading_to_the_elevation():
    document = calibration_document(RUN, POSES)
    elevation_deg = (60.37 - document["bias_deg"]) / document["scale"]
    assert elevation_deg == pytest.approx(60.0, abs=1e-9)


def test_with_effects_in_force_bias_and_scale_are_those_beside_them():
    """The unit warmed from one end of the sweep to the other: without the effect that would be scale."""
    theta, celsius = np.linspace(-60.0, 60.0, 5), np.array([20.0, 22.0, 23.0, 25.0, 26.0])
    per_c, reference_c = 0.05, 21.0
    poses = [
        Pose(t, 0.25 + 1.002 * t + per_c * (c - reference_c), temperature_c=c)
        for t, c in zip(theta.tolist(), celsius.tolist(), strict=True)
    ]
    parameters = {"deg_per_c": per_c, "reference_c": reference_c}
    warmth = AcceptedEffect("12", "AS-0042", None, "temperature_bias", "sensor", parameters)
    document = calibration_document(RUN, poses, [warmth])
    assert (document["bias_deg"], document["scale"]) == pytest.approx((0.25, 1.002), abs=1e-9)
    assert [effect["parameters"] for effect in document["effects"]] == [parameters]
    of_warmth = per_c * np.polyfit(theta, celsius, 1)[0]
    assert calibration_document(RUN, poses)["scale"] == pytest.approx(1.002 + of_warmth)


@pytest.mark.parametrize(
    "change",
    [{"result": None}, {"result": {**RUN.result, "scale": None}}, {"finished_at": None}],
)
def test_a_run_without_a_known_scale_has_no_document(change):
    with pytest.raises(ValueError, match="run 17 is not a finished calibration"):
        calibration_document(dataclasses.replace(RUN, **change), POSES)
