"""A unit's calibration document: CONTRACT section 6's names, and arithmetic that gives the elevation back."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from calrig.analysis.results import fitted
from calrig.calibration.poses import Pose
from calrig.calibration.uncertainty.budget import Reference
from calrig.export.calibration_document import calibration_content
from calrig.model.result import Gyro
from calrig.store import AcceptedEffect

RESIDUALS_DEG = (0.01, -0.02, 0.0, 0.02, -0.01)
POSES = [
    Pose(target, 0.25 + 1.002 * target + residual)
    for target, residual in zip((-60.0, -30.0, 0.0, 30.0, 60.0), RESIDUALS_DEG, strict=True)
]
GYRO = Gyro(bias_dps=[0.1, -0.2, 0.3], bias_std_dps=[0.01] * 3, scale=1.001, scale_std=0.0002)


def content(
    poses: Sequence[Pose] = POSES,
    accepted: Sequence[AcceptedEffect] = (),
    reference: Reference | None = None,
) -> dict[str, Any]:
    """What a revision says of AS-0042."""
    result = fitted(poses, accepted, {}, GYRO)
    return calibration_content(
        unit="AS-0042", rig="bench-1", poses=poses, result=result, accepted=accepted, reference=reference
    )


def test_the_content_has_the_contracts_names_and_is_json():
    found = json.loads(json.dumps(content(), allow_nan=False))
    known = ("covariance", "rms_raw_deg", "rms_calibrated_deg", "uncertainty")
    assert found == {
        "schema": "calrig.calibration/2",
        "unit": "AS-0042",
        "rig": "bench-1",
        "range_deg": [-60.0, 60.0],
        "model": "elevation = (reading − bias − effects)/scale",
        "bias_deg": pytest.approx(0.25),
        "scale": pytest.approx(1.002),
        "effects": [],
        "joint_covariance": None,
        "readings_wrap": None,
        "gyro": {"bias_dps": [0.1, -0.2, 0.3], "scale": 1.001},
        "rms_with_effects_deg": None,
        "expanded_uncertainty_deg": None,
        "coverage_factor": None,
        "coverage": 0.95,
        "level_known": False,
        "level_std_deg": None,
        "accelerometer": None,
        "temperature_c": None,
        "degrees_of_freedom": 3,
        **{name: found[name] for name in known},
    }


def test_its_covariance_is_that_of_its_results_standard_errors():
    document, result = content(), fitted(POSES, [], {})
    np.testing.assert_allclose(
        np.sqrt(np.diag(document["covariance"])), [result.bias_std_deg, result.scale_std], rtol=1e-9
    )


def test_what_the_stage_is_worth_enters_whole_however_many_poses_there_are():
    for poses in (POSES, POSES * 40):
        document = content(poses, reference=Reference(0.29))
        parts = document["uncertainty"]
        assert parts["reference_deg"] == parts["type_b_deg"] == 0.29
        assert document["expanded_uncertainty_deg"] == pytest.approx(
            document["coverage_factor"] * math.hypot(parts["type_a_deg"], 0.29)
        )
        assert document["coverage_factor"] == pytest.approx(1.65, abs=0.02)


def test_the_stages_part_of_bias_and_scale_is_told_apart():
    """All poses off by one unknown constant: the bias takes it whole, times the scale; the scale nothing."""
    parts = content(reference=Reference(0.29, "common"))["uncertainty"]
    assert parts["reference_bias_deg"] == pytest.approx(0.29 * 1.002)
    assert parts["reference_scale"] == 0.0


def test_applying_the_document_takes_a_reading_to_the_elevation():
    document = content()
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
    document = content(poses, [warmth])
    assert (document["bias_deg"], document["scale"]) == pytest.approx((0.25, 1.002), abs=1e-9)
    assert [effect["parameters"] for effect in document["effects"]] == [parameters]
    of_warmth = per_c * np.polyfit(theta, celsius, 1)[0]
    assert content(poses)["scale"] == pytest.approx(1.002 + of_warmth)


def test_poses_at_one_angle_give_no_calibration():
    with pytest.raises(ValueError, match="scale"):
        content([Pose(0.0, 0.1), Pose(0.0, 0.2)])
