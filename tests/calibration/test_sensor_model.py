"""Errors of the sensor's axes of any size: measured, applied, and nothing named beside them.

MPU-6050, PS-MPU-6000A rev. 3.4, section 6.2: offsets of ±50 mg (x, y) and ±80 mg (z), gains of ±3 %,
cross-axis sensitivity of ±2 %. The poses are the simulator's: a mount 0.8° off level, a stage 0.2 %
too far round.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from studies.blind.cells import Cell
from studies.blind.physics import Cause, Noise

from calrig.calibration.diagnosis.candidates import documented_forms
from calrig.calibration.diagnosis.report import covariance_of
from calrig.calibration.diagnosis.sensor_model import fitted_model
from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.regression.effect import Circumstances
from calrig.calibration.regression.responses import responses_of
from calrig.calibration.results.correction import calibrated_elevation_deg, effects_on_reading_deg, numbers_of
from calrig.calibration.results.result import build_result

NOISE = Noise(reading_deg=0.009, norm_mg=0.1, move_deg=0.006)
SKEW_DEG = math.degrees(math.asin(0.02))
OFFSET, MISMATCH = "accelerometer_offset", "axis_mismatch"


def poses_of(seed, y_mg, z_mg, gain_pct=0.0, skew_deg=0.0, noise=NOISE):
    """100 poses within ±60° of a sensor with these errors."""
    imu = {
        "accel_bias_mg": [0.0, y_mg, z_mg],
        "accel_gain_error_pct": [0.0, gain_pct, 0.0],
        "accel_cross_axis_deg": {"yz": skew_deg},
    }
    cause = Cause(OFFSET, "sensor", "target_deg", {"imu": imu})
    return Cell("large", "one", (lambda rng, when: cause,), noise=noise).run(seed).poses


def traced(poses):
    return document(diagnose([poses], bootstraps=199, cross_fit=False), ["1"])


def test_offset_gain_and_skew_at_a_data_sheets_limits_are_measured_and_applied_and_nothing_else_is_named():
    truth = {"y_mg": 80.0, "z_mg": -80.0, "gain_pct": 3.0, "skew_deg": SKEW_DEG}
    poses = poses_of(1, **truth)

    found = traced(poses)

    assert {e["name"]: e["verdict"] for e in found["effects"]} == {OFFSET: "named", MISMATCH: "named"}
    stated = {name: value for e in found["effects"] for name, value in e["parameters"].items()}
    for name, true in truth.items():
        assert stated[name]["value"] == pytest.approx(true, abs=4.0 * stated[name]["std"])
    left_deg = found["final"]["fit_rms_deg"]
    assert left_deg == pytest.approx(NOISE.reading_deg, rel=0.25)
    accepted = [(e["name"], numbers_of(e["parameters"])) for e in found["effects"]]
    result = build_result(poses, effects=accepted)
    readings_deg, line = np.array([pose.reading_deg for pose in poses]), result.over_range
    applied_deg = calibrated_elevation_deg(readings_deg, line.bias_deg, line.scale, accepted)
    error_deg = applied_deg - [pose.theta_deg for pose in poses]
    assert result.rms_with_effects_deg == pytest.approx(math.sqrt(np.mean(error_deg**2)), rel=0.005)


@pytest.mark.parametrize(("y_mg", "z_mg"), [(12.0, -20.0), (30.0, -50.0), (40.0, 60.0)])
def test_a_large_offset_leaves_nothing_to_be_named_beside_it(y_mg, z_mg):
    found = traced(poses_of(2, y_mg, z_mg))

    (effect,) = found["effects"]
    assert (effect["name"], effect["verdict"]) == (OFFSET, "named")
    for name, true in (("y_mg", y_mg), ("z_mg", z_mg)):
        stated = effect["parameters"][name]
        assert stated["value"] == pytest.approx(true, abs=4.0 * stated["std"])


def test_effects_on_the_axes_turn_one_vector_and_come_off_again():
    felt_deg = 4.0 + 1.01 * np.linspace(-60.0, 60.0, 25)
    felt = np.radians(felt_deg)
    y = 1.03 * (np.sin(felt) + np.cos(felt) * math.sin(math.radians(1.0))) + 0.05
    reading_deg = np.degrees(np.arctan2(y, np.cos(felt) - 0.08))
    effects = [
        (MISMATCH, {"gain_pct": 3.0, "skew_deg": 1.0}),
        ("temperature_offset", {"y_mg_per_c": 10.0, "z_mg_per_c": -16.0, "reference_c": 25.0}),
    ]
    given = Circumstances(temperature_c=np.full(25, 30.0))

    added_deg = effects_on_reading_deg(effects, np.linspace(-60.0, 60.0, 25), given, felt_deg)

    np.testing.assert_allclose(felt_deg + added_deg, reading_deg, atol=1e-12)
    theta_deg = calibrated_elevation_deg(reading_deg, 4.0, 1.01, effects, given)
    np.testing.assert_allclose(theta_deg, np.linspace(-60.0, 60.0, 25), atol=1e-9)


def test_a_small_error_is_fitted_in_one_linear_step():
    r = responses_of([poses_of(3, 0.05, 0.05)])
    offset = documented_forms(r, OFFSET, "target_deg", {"y_mg": 0.0, "z_mg": 0.0})

    assert fitted_model(r, offset).responses is r


@pytest.mark.statistical
def test_errors_of_offset_gain_and_skew_are_what_their_standard_errors_say():
    truth = {"y_mg": 80.0, "z_mg": 60.0, "gain_pct": -3.0, "skew_deg": SKEW_DEG}
    pulls = []
    for seed in range(40):
        r = responses_of([poses_of(seed, **truth)])
        (offset,) = documented_forms(r, OFFSET, "target_deg", truth)
        (mismatch,) = documented_forms(r, MISMATCH, "target_deg", truth)
        model = fitted_model(r, [offset, mismatch])
        covariance = covariance_of(model.responses, model.columns, model.fitted)
        off = model.fitted.beta[-4:] - np.array(list(truth.values()))
        pulls.append(off / np.sqrt(np.diag(covariance))[-4:])
    # of 40 pulls the root mean square scatters by 0.11
    assert np.sqrt((np.array(pulls) ** 2).mean(axis=0)) == pytest.approx(1.0, abs=0.4)
