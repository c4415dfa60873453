"""A run's result: the contract's keys, null for what is not known, RMS before and after."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from support import DATA

from calrig.analysis.known_calibration import reading_doubts
from calrig.calibration.line import Line
from calrig.calibration.poses import Pose
from calrig.calibration.results.correction import own_effect
from calrig.calibration.results.pose_errors import residuals
from calrig.calibration.results.result import RELATIVE, apply_calibration, build_result
from calrig.calibration.uncertainty.budget import Reference
from calrig.calibration.uncertainty.doubts import pose_doubts
from calrig.export.calibration_document import calibration_content
from calrig.model.result import Gyro


def test_a_runs_result_has_the_contracts_keys_and_is_json():
    targets_deg = np.tile(np.arange(-60.0, 61.0, 20.0), 2)
    rng = np.random.default_rng(0)
    poses = [
        Pose(
            target_deg=t,
            stage_deg=t + 0.1,
            reading_deg=0.5 + 1.01 * (t + 0.1) + e,
            reading_stderr_deg=s,
            temperature_c=c,
        )
        for t, e, s, c in zip(
            targets_deg, rng.normal(0.0, 0.02, 14), [0.01, 0.03] * 7, np.linspace(20.0, 24.0, 14), strict=True
        )
    ]

    gyro = Gyro(bias_dps=[1.0, 2.0, None], bias_std_dps=[0.1, 0.1, None], scale=1.02, scale_std=0.001)
    document = build_result(poses, gyro).to_dict()

    assert list(document) == [
        "bias_deg",
        "bias_std_deg",
        "scale",
        "scale_std",
        "rms_raw_deg",
        "rms_calibrated_deg",
        "rms_with_effects_deg",
        "n_poses",
        "noise_deg",
        "temperature_c",
        "gyro",
        "reference",
        "over_range",
        "stopped_by",
    ]
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["bias_deg"] == pytest.approx(0.5, abs=4 * document["bias_std_deg"])
    assert document["scale"] == pytest.approx(1.01, abs=4 * document["scale_std"])
    assert document["noise_deg"] == pytest.approx(math.sqrt((0.01**2 + 0.03**2) / 2))
    assert document["temperature_c"] == {"min": 20.0, "max": 24.0}
    assert document["gyro"] == {
        "bias_dps": [1.0, 2.0, None],
        "bias_std_dps": [0.1, 0.1, None],
        "scale": 1.02,
        "scale_std": 0.001,
    }


def test_rms_is_before_and_after_calibration_with_no_degrees_of_freedom_taken_off():
    """Readings 1 too high but for ±0.3: 1.04 before, 0.3/scale after."""
    poses = [Pose(target_deg=t, reading_deg=t + 1.0 + e) for t in (-10.0, 10.0) for e in (-0.3, 0.3)]

    result = build_result(poses)

    assert result.rms_raw_deg == pytest.approx(math.sqrt(1.0 + 0.09))
    assert result.rms_calibrated_deg == pytest.approx(0.3)
    assert residuals(poses, result.bias_deg, result.scale) == pytest.approx([-0.3, 0.3, -0.3, 0.3])


def test_what_poses_do_not_say_is_null_not_missing():
    document = build_result([Pose(target_deg=0.0, reading_deg=0.2)]).to_dict()

    assert document == {
        "bias_deg": 0.2,
        "bias_std_deg": None,
        "scale": None,
        "scale_std": None,
        "rms_raw_deg": 0.2,
        "rms_calibrated_deg": 0.0,
        "rms_with_effects_deg": None,
        "n_poses": 1,
        "noise_deg": None,
        "temperature_c": None,
        "gyro": {"bias_dps": [None] * 3, "bias_std_dps": [None] * 3, "scale": None, "scale_std": None},
        "reference": None,
        "over_range": {
            "bias_deg": 0.2,
            "scale": None,
            "covariance": None,
            "freedom": 0,
            "expanded_uncertainty_deg": None,
            "error_expanded_uncertainty_deg": None,
            "coverage_factor": None,
            "coverage": 0.95,
            "elevation_deg": [0.0],
            "lowest_error_deg": [0.0],
            "highest_error_deg": [0.0],
            "mean_error_deg": 0.0,
            "error_steps": None,
        },
        "stopped_by": "plan",
    }


@pytest.mark.parametrize("sweeps", [2, 5, 20])
@pytest.mark.parametrize("kind", ["common", "harmonic", "setting"])
def test_twice_the_sweeps_are_worth_a_root_of_two_in_type_a_and_nothing_in_what_the_stage_is_worth(
    kind, sweeps
):
    rng = np.random.default_rng(sweeps)
    theta_deg = np.tile(np.arange(-60.0, 61.0, 10.0), sweeps)
    once = [
        Pose(target_deg=t, reading_deg=0.5 + 1.01 * t + e)
        for t, e in zip(theta_deg, rng.normal(0.0, 0.03, len(theta_deg)), strict=True)
    ]
    few, many = (build_result(poses, reference=Reference(0.29, kind)) for poses in (once, once * 2))

    # how the noise of the fewer poses is correlated is known less well
    assert few.bias_std_deg / many.bias_std_deg == pytest.approx(math.sqrt(2.0), rel=0.2)
    assert few.scale_std / many.scale_std == pytest.approx(math.sqrt(2.0), rel=0.2)

    stays = math.sqrt(2.0) if kind == "setting" else 1.0  # a fault made anew at each pose averages out
    assert (many.reference.std_deg, many.reference.kind) == (0.29, kind)
    assert few.reference.bias_std_deg / many.reference.bias_std_deg == pytest.approx(stays)
    assert few.reference.scale_std == pytest.approx(stays * many.reference.scale_std)


def test_poses_commanded_to_one_angle_have_no_scale_though_the_stage_jitters():
    poses = [Pose(target_deg=5.0, stage_deg=5.0 + k * 0.001, reading_deg=5.3) for k in range(5)]

    result = build_result(poses)

    assert result.scale is None
    assert result.bias_deg == pytest.approx(0.298)


def test_a_stuck_sensor_gives_null_where_nothing_can_be_divided():
    poses = [Pose(target_deg=t, reading_deg=3.0) for t in (-20.0, 0.0, 20.0)]

    result = build_result(poses)

    assert result.rms_calibrated_deg is None
    assert residuals(poses, result.bias_deg, result.scale) == [None, None, None]
    json.dumps(result.to_dict(), allow_nan=False)


def test_a_stuck_sensor_that_makes_noise_has_no_calibrated_error_and_is_not_released_by_itself():
    noise = np.random.default_rng(1).normal(0.0, 0.02, 20)
    poses = [Pose(t, 5.0 + n) for t, n in zip([-20.0, -10.0, 0.0, 10.0, 20.0] * 4, noise, strict=True)]

    result = build_result(poses)

    assert result.rms_raw_deg > 10.0
    assert result.rms_calibrated_deg is None
    assert result.over_range is None
    assert [doubt.kind for doubt in pose_doubts(result, 0)] == ["ambiguous_readings"]


@pytest.mark.parametrize("factor", [math.pi / 180.0, 200.0 / 180.0, 60.0, -1.0])
def test_a_reading_in_another_unit_or_sense_is_not_released_by_itself(factor):
    poses = [Pose(t, factor * (t + 0.3)) for t in (-2.0, -1.0, 0.0, 1.0, 2.0)]

    result = build_result(poses)

    of_degrees = factor == 200.0 / 180.0  # gradians: no more than a poor sensor may err
    assert [doubt.kind for doubt in pose_doubts(result, 0)] == ([] if of_degrees else ["odd_scale"])


def test_a_run_without_poses_has_no_result():
    with pytest.raises(ValueError, match="needs poses"):
        build_result([])
    assert residuals([], 0.0, 1.0) == []


def test_measured_warm_up_at_one_angle():
    """MPU-6050 poses at target 0 while the die warms: RMS 0.062° about the mean (DESIGN.md), no scale."""
    file = DATA / "mpu6050_warmup_poses.csv"
    if not file.is_file():
        pytest.skip(f"no measured data at {file}; set CALRIG_DATA to where it lies")
    with file.open(encoding="utf-8-sig", newline="") as rows:
        poses = [
            Pose(target_deg=float(r["target_deg"]), reading_deg=float(r["reading_deg"]))
            for r in csv.DictReader(rows)
        ]

    result = build_result(poses)

    assert result.scale is None
    assert result.rms_calibrated_deg == pytest.approx(0.062, abs=0.0005)
    assert result.rms_raw_deg == pytest.approx(math.hypot(result.bias_deg, result.rms_calibrated_deg))


def test_a_calibration_that_does_not_know_the_level_is_verified_however_the_unit_is_clamped():
    offset = [("accelerometer_offset", {"y_mg": 20.0, "z_mg": -30.0})]
    elevations = np.arange(-60.0, 61.0, 10.0)
    line = Line(0.0, 1.0, 0.0, 0.0, ((0.0, 0.0), (0.0, 0.0)), 0.0)
    for clamped_deg in (0.0, 0.9, -3.0):
        felt = np.radians(elevations + clamped_deg)
        readings = np.degrees(np.arctan2(np.sin(felt) + 0.020, np.cos(felt) - 0.030))
        poses = [
            Pose(target_deg=t, reading_deg=r, sweep=k % 2)
            for k, (t, r) in enumerate(zip(elevations, readings, strict=True))
        ]
        known = apply_calibration(poses, None, line, offset)
        found = apply_calibration(poses, None, line, offset, clamped_anew=True)
        assert found.rms_with_effects_deg < 1e-3
        assert known.rms_with_effects_deg == pytest.approx(
            abs(clamped_deg), abs=0.02 + 0.05 * abs(clamped_deg)
        )
        assert (found.bias_deg, found.reference_says) == (0.0, RELATIVE)


def test_errors_with_a_curve_are_of_the_elevation_that_solves_it():
    theta, bend, noise_deg = np.tile(np.arange(20.0, 81.0, 1.0), 9), -0.006, 0.05
    noise = np.random.default_rng(1).normal(0.0, noise_deg, len(theta))
    reading = 3.0 + 1.3 * theta + bend * theta**2 + noise
    poses = [Pose(float(at), float(read)) for at, read in zip(theta, reading, strict=True)]
    reference = Reference(std_deg=1e-6)
    result = build_result(poses, effects=[("nonlinearity", {"deg_per_deg2": bend})], reference=reference)
    fitted = result.over_range
    solved = [
        min(np.roots([bend, fitted.scale, fitted.bias_deg - read]).real, key=lambda root: abs(root - at))
        for at, read in zip(theta, reading, strict=True)
    ]
    error_deg = np.array(solved) - theta
    assert result.rms_with_effects_deg == pytest.approx(np.sqrt(np.mean(error_deg**2)), rel=0.01)
    at_the_end = error_deg[theta == 80.0]
    assert np.std(at_the_end) > 2 * noise_deg, "there a reading grows by a third of a degree per degree"
    type_a_deg = fitted.expanded_uncertainty_deg / fitted.coverage_factor
    assert type_a_deg == pytest.approx(result.rms_with_effects_deg, rel=0.1)


def waves(amplitude_deg):
    """Two turns of an encoder with a wave of 30° and much noise: poses, effects, true amplitude."""
    theta = np.arange(0.0, 720.0, 1.7)
    reading = theta + amplitude_deg * np.sin(np.radians(12.0 * theta))
    reading += np.random.default_rng(4).normal(0.0, 0.5, len(theta))
    poses = [Pose(float(at), float(read)) for at, read in zip(theta, reading, strict=True)]
    values = {"amplitude_deg": amplitude_deg, "period_deg": 30.0, "phase_deg": 0.0}
    return poses, [own_effect("stage_periodic", values)]


def test_where_a_curve_is_steep_errors_are_of_the_elevation_whose_reading_it_is():
    poses, effects = waves(4.0)
    result = build_result(poses, effects=effects)
    line = result.line_with_effects
    grid = np.arange(-20.0, 740.0, 0.001)
    curve = line.bias_deg + line.scale * grid + 4.0 * np.sin(np.radians(12.0 * grid))
    assert (np.diff(curve) > 0.0).all()
    error_deg = [np.interp(pose.reading_deg, curve, grid) - pose.target_deg for pose in poses]
    assert result.rms_with_effects_deg == pytest.approx(np.sqrt(np.mean(np.square(error_deg))), rel=1e-4)


def test_a_curve_that_turns_round_has_no_error_of_an_elevation_and_is_not_released_by_itself():
    poses, effects = waves(8.0)
    result = build_result(poses, effects=effects)
    content = calibration_content(unit="A", rig=None, poses=poses, result=result)
    content["effects"] = [{"name": name, "parameters": values} for name, values in effects]
    assert result.rms_with_effects_deg is None
    (doubt,) = reading_doubts(content)
    assert (doubt.kind, "turns round" in doubt.says) == ("ambiguous_readings", True)


TO_AND_FRO_DEG = np.tile(np.concatenate([np.arange(-60.0, 60.0, 5.0), np.arange(60.0, -60.0, -5.0)]), 2)


def _to_and_fro(error_deg, noise_deg=0.05):
    """Poses of two sweeps to and fro with an error (n,)."""
    noise = np.random.default_rng(1).normal(0.0, noise_deg, len(TO_AND_FRO_DEG))
    readings_deg = 0.4 + 1.01 * TO_AND_FRO_DEG + error_deg + noise
    return [
        Pose(target_deg=t, reading_deg=r) for t, r in zip(TO_AND_FRO_DEG, readings_deg.tolist(), strict=True)
    ]


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_a_reading_that_lost_a_digit_is_named_and_keeps_the_calibration_a_draft(scale):
    poses = _to_and_fro(np.zeros(96), noise_deg=0.05 * scale)
    poses[30] = replace(poses[30], reading_deg=poses[30].reading_deg / 10.0)
    (doubt,) = pose_doubts(build_result(poses), 0)
    assert doubt.kind == "far_poses"
    assert f"{poses[30].reading_deg:g}° at {poses[30].target_deg:g}°".replace("-", "−") in doubt.says
    verified = apply_calibration(poses, None, build_result(poses[:30]).line, [])
    assert pose_doubts(verified, 0) == []  # it fits nothing that would follow the pose


@pytest.mark.parametrize(
    "error_deg",
    [
        2.0 * np.repeat([0.0, 1.0, 0.0, 1.0], 24),  # play
        np.where(np.arange(96) < 80, 0.0, 8.0),  # a slip
        3.0 * np.exp(-np.arange(96) / 4.0),  # a warm-up
        np.where(TO_AND_FRO_DEG == 40.0, 3.0, 0.0),  # of the angle
        np.where(np.arange(96) == 0, 3.0, 0.0),  # play taken up
        np.random.default_rng(2).standard_t(5, 96) * 0.2,
    ],
)
def test_poses_that_an_effect_or_noise_may_have_moved_are_no_doubt(error_deg):
    assert pose_doubts(build_result(_to_and_fro(error_deg)), 0) == []
    rounded = _to_and_fro(np.round(error_deg), noise_deg=0.0)
    assert pose_doubts(build_result(rounded), 0) == []
