"""What was traced is what is applied: the error that a diagnosis promises, acceptance gives."""

from __future__ import annotations

import math

import pytest
from studies.blind.causes import bias_tempco, package_turn
from studies.blind.cells import Cell
from studies.blind.physics import Cause

from calrig.calibration.diagnosis.report import partial_residuals
from calrig.calibration.diagnosis.tracing import diagnose, trace
from calrig.calibration.results.correction import numbers_of
from calrig.calibration.results.result import build_result

DEG_PER_C = 0.1
NOISE_DEG = 0.03


def traced(cause):
    """100 poses of the simulator's physics within ±60°, warming up by 6 °C, and their diagnosis."""
    poses = Cell("traced and applied", "one", (cause,)).run(seed=1).poses
    return poses, trace([poses], ["1"])


def applied_rms_deg(poses, effects):
    return build_result(poses, effects=effects).rms_with_effects_deg


def test_an_offset_of_the_y_axis_that_moves_with_temperature_is_applied_as_it_was_fitted():
    poses, found = traced(bias_tempco(DEG_PER_C))
    (effect,) = found["effects"]
    assert (effect["name"], effect["verdict"]) == ("temperature_offset", "named")
    of_y = effect["parameters"]["y_mg_per_c"]
    mg_per_c = 1e3 * math.radians(DEG_PER_C)
    assert abs(of_y["value"]) == pytest.approx(mg_per_c, abs=3.0 * of_y["std"])

    accepted = numbers_of(effect["parameters"])
    promised_deg = found["final"]["held_out_rms_deg"]
    assert promised_deg == pytest.approx(NOISE_DEG, rel=0.2)
    assert applied_rms_deg(poses, [(effect["name"], accepted)]) == pytest.approx(promised_deg, rel=0.08)
    everywhere_alike = {
        "deg_per_c": math.degrees(accepted["y_mg_per_c"] / 1e3),
        "reference_c": accepted["reference_c"],
    }
    assert applied_rms_deg(poses, [("temperature_bias", everywhere_alike)]) > 1.2 * promised_deg

    (drawn,) = partial_residuals([poses], found["effects"])
    level = min(range(len(poses)), key=lambda k: abs(drawn.theta_deg[k]))
    steep = max(range(len(poses)), key=lambda k: abs(drawn.theta_deg[k]))
    line = build_result(poses, effects=[(effect["name"], accepted)]).line_with_effects
    for k in (level, steep):
        error_g = 1e-3 * (poses[k].temperature_c - accepted["reference_c"])
        felt = math.radians(line.bias_deg + line.scale * drawn.theta_deg[k])  # the sensor's own elevation
        y = math.sin(felt) + accepted["y_mg_per_c"] * error_g
        z = math.cos(felt) + accepted["z_mg_per_c"] * error_g
        turned_deg = math.degrees(math.atan2(y, z) - felt)
        assert drawn.effect_deg[k] == pytest.approx(turned_deg, rel=1e-3)


def test_a_package_that_turns_with_temperature_says_nothing_of_an_axis():
    poses, found = traced(package_turn(DEG_PER_C))
    (effect,) = found["effects"]
    assert set(effect["parameters"]) == {"deg_per_c", "reference_c"}
    accepted = [(effect["name"], numbers_of(effect["parameters"]))]
    assert applied_rms_deg(poses, accepted) == pytest.approx(found["final"]["held_out_rms_deg"], rel=0.08)


def test_gains_that_all_drift_alike_turn_no_reading_and_are_no_effect_of_it():
    def every_gain(_rng, _when):
        return Cause("none", "sensor", "temperature_c", {"imu": {"accel_gain_pct_per_c": [0.1, 0.1, 0.1]}})

    poses = Cell("gains alike", "one", (every_gain,)).run(seed=1).poses
    assert diagnose([poses], bootstraps=199, cross_fit=False).findings.found == ()
