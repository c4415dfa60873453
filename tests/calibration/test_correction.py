"""Effects applied by the contract's formulas, and the elevation found back from a reading."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calrig.calibration.effects import CATALOGUE, EFFECTS
from calrig.calibration.poses import Pose
from calrig.calibration.regression.effect import ApplyError, Circumstances
from calrig.calibration.regression.responses import responses_of
from calrig.calibration.results.correction import (
    calibrated_elevation_deg,
    effects_on_reading_deg,
    fit_line_with_effects,
    numbers_of,
)

THETA_DEG = np.array([-60.0, -25.0, 0.0, 10.0, 45.0, 60.0])
GIVEN = Circumstances(
    approach=np.array([1.0, -1.0, 0.0, 1.0, 1.0, -1.0]),
    temperature_c=np.array([20.0, 22.0, 25.0, 27.0, 30.0, 31.0]),
    time_s=np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0]),
    move_deg=np.array([math.nan, 35.0, 25.0, 10.0, 35.0, 15.0]),
    velocity_dps=np.array([0.0, 5.0, -5.0, 5.0, 0.0, 5.0]),
    kappa=np.full(6, -0.05),
)


@pytest.mark.parametrize(
    ("name", "parameters", "expected"),
    [
        ("backlash", {"backlash_deg": 0.08}, lambda k, t: 0.04 * GIVEN.get("approach")[k]),
        (
            "stage_eccentricity",
            {"amplitude_deg": 0.1, "phase_deg": 30.0},
            lambda k, t: 0.1 * math.sin(math.radians(t + 30.0)),
        ),
        (
            "stage_periodic",
            {"amplitude_deg": 0.06, "period_deg": 7.2, "phase_deg": 40.0},
            lambda k, t: 0.06 * math.sin(math.radians(360.0 * t / 7.2 + 40.0)),
        ),
        ("nonlinearity", {"deg_per_deg3": 1e-7}, lambda k, t: 1e-7 * t**3),
        (
            "temperature_bias",
            {"deg_per_c": 0.02, "reference_c": 25.0},
            lambda k, t: 0.02 * (GIVEN.get("temperature_c")[k] - 25.0),
        ),
        (
            "temperature_curvature",
            {"deg_per_c2": 0.001, "reference_c": 25.0},
            lambda k, t: 0.001 * (GIVEN.get("temperature_c")[k] - 25.0) ** 2,
        ),
        (
            "temperature_scale",
            {"per_c": 1e-4, "reference_c": 25.0},
            lambda k, t: 1e-4 * (GIVEN.get("temperature_c")[k] - 25.0) * t,
        ),
        ("time_drift", {"deg_per_s": 1e-3}, lambda k, t: 1e-3 * GIVEN.get("time_s")[k]),
        ("mount_slip", {"step_deg": 0.12, "at_s": 25.0}, lambda k, t: 0.12 if k >= 3 else 0.0),
        (
            "settling",
            {"fraction": 0.01},
            lambda k, t: 0.0 if k == 0 else -0.01 * GIVEN.get("move_deg")[k],
        ),
        ("latency", {"delay_s": 0.02}, lambda k, t: -0.02 * GIVEN.get("velocity_dps")[k]),
    ],
)
def test_an_effect_adds_what_the_contract_says(name, parameters, expected):
    added_deg = effects_on_reading_deg([(name, parameters)], THETA_DEG, GIVEN)
    assert added_deg.tolist() == pytest.approx([expected(k, t) for k, t in enumerate(THETA_DEG)], abs=1e-12)


@pytest.mark.parametrize(
    ("name", "parameters", "measured"),
    [
        ("accelerometer_offset", {"y_mg": 20.0, "z_mg": -30.0}, lambda y, z: (y + 0.02, z - 0.03)),
        (
            "axis_mismatch",
            {"gain_pct": 1.5, "skew_deg": 0.8},
            lambda y, z: (1.015 * (y + z * math.sin(math.radians(0.8))), z),
        ),
    ],
)
def test_an_accelerometers_error_turns_the_vector_it_measures(name, parameters, measured):
    added_deg = effects_on_reading_deg([(name, parameters)], THETA_DEG)
    for theta, added in zip(np.radians(THETA_DEG), added_deg, strict=True):
        y, z = measured(math.sin(theta), math.cos(theta))
        assert added == pytest.approx(math.degrees(math.atan2(y, z) - theta), abs=1e-12)


def test_a_y_axis_whose_offset_moves_with_temperature_turns_the_vector_it_measures():
    of_axis_y = {"deg_per_c": 0.02, "reference_c": 25.0, "of_axis_y": 1.0}
    added_deg = effects_on_reading_deg([("temperature_bias", of_axis_y)], THETA_DEG, GIVEN)
    y = np.sin(np.radians(THETA_DEG)) + np.radians(0.02 * (GIVEN.get("temperature_c") - 25.0))
    turned_deg = np.degrees(np.arctan2(y, np.cos(np.radians(THETA_DEG)))) - THETA_DEG
    np.testing.assert_allclose(added_deg, turned_deg, atol=1e-12)


def poses_with_everything():
    rng = np.random.default_rng(0)
    theta_deg = rng.uniform(-60.0, 60.0, 40)
    move_deg = np.diff(theta_deg, prepend=theta_deg[0])
    return [
        Pose(
            t,
            t + e,
            approach=int(np.sign(m)) or 1,
            time_s=10.0 * k,
            temperature_c=20 + k**2 / 360,
            gyro_move_deg=m + e,
            accel_x_g=0.02 + 0.01 * math.cos(math.radians(t)) + 1e-4 * e,
            accel_y_g=math.sin(math.radians(t + e)),
            accel_z_g=math.cos(math.radians(t + e)),
        )
        for k, (t, m, e) in enumerate(zip(theta_deg, move_deg, rng.normal(0.0, 0.03, 40), strict=True))
    ]


SMALL = {"y_mg": 0.1, "z_mg": 0.1, "gain_pct": 0.01, "skew_deg": 0.01}


SEARCHED = [effect for effect in CATALOGUE if effect.name != "axis_nonlinearity"]
"""All but what the joint solution alone finds."""


@pytest.mark.parametrize("effect", SEARCHED, ids=lambda effect: effect.name)
def test_formulas_agree_with_the_columns_that_the_search_fits(effect):
    """Small effects, so that what the search linearises is exact to 1e-7°."""
    poses = poses_with_everything()
    r = responses_of([poses])
    r = dataclasses.replace(r, covariates={"velocity_dps": np.linspace(-5.0, 5.0, len(r))})
    given_here = Circumstances(
        approach=r.approach,
        temperature_c=r.temperature_c,
        time_s=r.time_s,
        move_deg=r.move_deg,
        velocity_dps=r.covariates["velocity_dps"],
        kappa=r.kappa,
    )
    shape = next(iter(effect.shapes(r)))
    if "phase_deg" in shape.parameters:
        parameters = {"amplitude_deg": 1.0, "phase_deg": 90.0, **shape.at}
        column = shape.shares["reading"][:, 1]
    else:
        values = [SMALL.get(name, 1e-3) for name in shape.parameters]
        parameters = {**dict(zip(shape.parameters, values, strict=True)), **shape.at}
        column = shape.shares["reading"].reshape(len(r), -1)[:, : len(values)] @ np.array(values)

    added_deg = effects_on_reading_deg([(effect.name, parameters)], r.theta_deg, given_here)

    np.testing.assert_allclose(added_deg, column, atol=3e-6)


def test_the_square_of_temperature_is_about_where_it_says_nothing_of_the_linear_coefficient():
    """Of a lopsided warm-up: a straight line through the column against temperature is level."""
    r = responses_of([poses_with_everything()])
    (shape,) = EFFECTS["temperature_curvature"].forms(r, {})
    column = shape.shares["reading"]
    assert np.polyfit(r.temperature_c, column, 1)[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(column, (r.temperature_c - shape.at["reference_c"]) ** 2, atol=1e-9)


@settings(max_examples=100, deadline=None)
@given(
    bias_deg=st.floats(-179.0, 179.0),
    scale=st.sampled_from([0.8, 1.0, 1.02, -1.0]),
    y_mg=st.floats(-50.0, 50.0),
    gain_pct=st.floats(-5.0, 5.0),
    per_c=st.floats(-1e-3, 1e-3),
)
def test_the_elevation_comes_back_from_a_reading_to_a_billionth_of_a_degree(
    bias_deg, scale, y_mg, gain_pct, per_c
):
    effects = [
        ("accelerometer_offset", {"y_mg": y_mg, "z_mg": 10.0}),
        ("axis_mismatch", {"gain_pct": gain_pct, "skew_deg": 0.5}),
        ("temperature_scale", {"per_c": per_c, "reference_c": 20.0}),
        ("nonlinearity", {"deg_per_deg2": 2e-5, "deg_per_deg3": 1e-6}),
    ]
    felt_deg = bias_deg + scale * THETA_DEG
    reading_deg = felt_deg + effects_on_reading_deg(effects, THETA_DEG, GIVEN, felt_deg)
    reading_deg = np.degrees(np.angle(np.exp(1j * np.radians(reading_deg))))

    found_deg = calibrated_elevation_deg(reading_deg, bias_deg, scale, effects, GIVEN)

    np.testing.assert_allclose(found_deg, THETA_DEG, atol=1e-9)


def test_a_fine_steep_error_of_the_stage_is_inverted_as_well():
    effects = [("stage_periodic", {"amplitude_deg": 0.5, "period_deg": 4.0, "phase_deg": 10.0})]
    reading_deg = THETA_DEG + effects_on_reading_deg(effects, THETA_DEG)
    np.testing.assert_allclose(
        calibrated_elevation_deg(reading_deg, 0.0, None, effects), THETA_DEG, atol=1e-9
    )


def test_a_pose_without_a_temperature_stays_unknown_and_the_others_do_not():
    effects = [("temperature_scale", {"per_c": 1e-4, "reference_c": 25.0})]
    known_of_one = Circumstances(temperature_c=np.array([math.nan, 35.0]))
    found_deg = calibrated_elevation_deg(np.array([10.0, 10.01]), 0.0, 1.0, effects, known_of_one)
    assert math.isnan(found_deg[0])
    assert found_deg[1] == pytest.approx(10.0)


def test_bias_and_scale_are_those_of_what_the_effects_leave():
    effects = [("temperature_bias", {"deg_per_c": 0.02, "reference_c": 25.0})]
    reading_deg = 0.3 + 1.01 * THETA_DEG + effects_on_reading_deg(effects, THETA_DEG, GIVEN)
    line = fit_line_with_effects(THETA_DEG, reading_deg, effects, GIVEN)
    assert (line.bias_deg, line.scale) == pytest.approx((0.3, 1.01), abs=1e-12)


def test_a_slip_has_happened_where_no_time_is_known():
    added_deg = effects_on_reading_deg([("mount_slip", {"step_deg": 0.12, "at_s": 25.0})], THETA_DEG)
    assert added_deg.tolist() == [0.12] * 6


def test_parameters_are_numbers_with_or_without_their_standard_errors():
    assert numbers_of(
        {"a": {"value": 1.5, "std": 0.1}, "b": 2, "c": None, "d": {"value": None, "std": None}}
    ) == {
        "a": 1.5,
        "b": 2.0,
    }


@pytest.mark.parametrize(
    ("name", "parameters", "says"),
    [
        ("unnamed", {"size_deg": 0.1}, "'unnamed' has no formula"),
        ("temperature_bias", {"deg_per_c": 0.02}, "temperature_bias needs temperature_c of every pose"),
        ("stage_periodic", {"amplitude_deg": 0.1}, "stage_periodic needs its parameter period_deg"),
    ],
)
def test_what_an_effect_lacks_is_said(name, parameters, says):
    with pytest.raises(ApplyError, match=says):
        effects_on_reading_deg([(name, parameters)], THETA_DEG)


def test_a_reading_that_effects_fold_stands_for_no_elevation():
    steep = [("stage_periodic", {"amplitude_deg": 5.0, "period_deg": 4.0})]
    assert np.isnan(calibrated_elevation_deg(THETA_DEG, 0.0, 1.0, steep)).any()
    with pytest.raises(ApplyError, match="the scale is 0"):
        calibrated_elevation_deg(THETA_DEG, 0.0, 0.0, [])
