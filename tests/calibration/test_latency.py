"""Readings that come late, of logs taken on the move: everything at θ(t − τ), and no settling."""

from __future__ import annotations

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.line import rms
from calrig.calibration.regression.motion import motion_of
from calrig.calibration.results.correction import fit_line_with_effects, numbers_of
from calrig.calibration.results.pose_errors import angles_deg, circumstances, without_effects_deg


def strokes_deg(time_s, half_travel_deg, speed_dps):
    """Elevation of a table that goes to and fro at a constant speed without a stop."""
    stroke_s = 2.0 * half_travel_deg / speed_dps
    return half_travel_deg - speed_dps * np.abs(np.mod(time_s, 2.0 * stroke_s) - stroke_s)


def found_in(poses, *, cross_fit=False):
    return document(diagnose([poses], bootstraps=199, cross_fit=cross_fit), ["1"])


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_at_one_speed_a_delay_and_a_backlash_are_both_said_and_nothing_settled(sense):
    time_s = np.arange(0.0, 121.0)
    late_deg = strokes_deg(time_s - 0.2, 60.0, 4.0)
    noise_deg = np.random.default_rng(0).normal(0.0, 0.02, len(time_s))
    reading_deg = sense * (late_deg + noise_deg)
    poses = posed(target_deg=strokes_deg(time_s, 60.0, 4.0), reading_deg=reading_deg, time_s=time_s)
    (effect,) = found_in(poses)["effects"]
    assert (effect["name"], effect["verdict"]) == ("latency", "ambiguous")
    assert effect["confusable_with"] == ["backlash"]
    assert effect["parameters"]["delay_s"]["value"] == pytest.approx(0.2, rel=0.05)


@pytest.mark.parametrize(("sense", "delay_s"), [(1.0, 0.05), (-1.0, 0.05), (1.0, -0.05)])
def test_a_delay_at_speeds_that_differ_stands_alone_and_its_words_hold_for_both_signs(sense, delay_s):
    time_s = np.arange(0.0, 60.0, 0.4)
    there_deg = [60.0 * np.sin(0.5 * at) + 10.0 * np.sin(1.7 * at) for at in (time_s, time_s - delay_s)]
    noise_deg = np.random.default_rng(1).normal(0.0, 0.05, len(time_s))
    reading_deg = sense * (0.3 + there_deg[1] + noise_deg)
    poses = posed(target_deg=there_deg[0], reading_deg=reading_deg, time_s=time_s)
    (effect,) = found_in(poses)["effects"]
    assert (effect["name"], effect["verdict"]) == ("latency", "named")
    assert effect["parameters"]["delay_s"]["value"] == pytest.approx(delay_s, rel=0.05)
    assert "subtract the delay" in effect["remedy"]
    assert "if it is negative" in effect["remedy"]


def test_a_start_that_is_far_off_hides_no_delay():
    """Four rows before the sensor has begun, with which all rows together say that it has no delay."""
    time_s = 0.008 * np.arange(714)
    there_deg = [10.0 * np.sin(19.0 * at) for at in (time_s, time_s - 0.005)]
    reading_deg = there_deg[1] + np.random.default_rng(3).normal(0.0, 1.0, len(time_s))
    reading_deg[2:6] = 85.0
    found = found_in(posed(target_deg=there_deg[0], reading_deg=reading_deg, time_s=time_s))
    delay = next(e["parameters"]["delay_s"] for e in found["effects"] if e["name"] == "latency")
    assert abs(delay["value"] - 0.005) < 3.0 * delay["std"]


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_move_that_has_not_settled_is_that_of_a_sensor_that_counts_either_way(sense):
    rng = np.random.default_rng(2)
    theta_deg = rng.uniform(-80.0, 80.0, 80)
    short_deg = 0.01 * np.diff(theta_deg, prepend=theta_deg[0])
    reading_deg = sense * (theta_deg - short_deg + rng.normal(0.0, 0.05, 80))
    (effect,) = found_in(posed(target_deg=theta_deg, reading_deg=reading_deg, time_s=5.0 * np.arange(80.0)))[
        "effects"
    ]
    assert (effect["name"], effect["verdict"]) == ("settling", "named")
    assert effect["parameters"]["fraction"]["value"] == pytest.approx(0.01, rel=0.1)


DELAY_S, ORDER_2_DEG, NOISE_DEG = 0.035, 8.0, 0.05


def three_turns(seed=0):
    """Three turns to and fro at 36°/s, with an order 2 of the angle that the late reading has."""
    rng = np.random.default_rng(seed)
    time_s = 0.5 * np.arange(200) + rng.uniform(0.0, 0.12, 200)
    late_deg = strokes_deg(time_s - DELAY_S, 540.0, 36.0)
    reading_deg = late_deg + ORDER_2_DEG * np.sin(2.0 * np.radians(late_deg) + 0.4)
    reading_deg += rng.normal(0.0, NOISE_DEG, len(time_s))
    return posed(target_deg=strokes_deg(time_s, 540.0, 36.0), reading_deg=reading_deg, time_s=time_s)


def test_an_order_is_that_of_the_elevation_that_the_late_reading_stands_for():
    found = found_in(three_turns(), cross_fit=True)
    effects = {effect["name"]: effect for effect in found["effects"]}
    assert effects.keys() == {"latency", "stage_periodic"}
    assert {effect["verdict"] for effect in effects.values()} == {"named"}
    delay = effects["latency"]["parameters"]["delay_s"]
    assert delay["value"] == pytest.approx(DELAY_S, rel=0.05)
    amplitude = effects["stage_periodic"]["parameters"]["amplitude_deg"]
    assert amplitude["value"] == pytest.approx(ORDER_2_DEG, rel=0.01)
    assert found["final"]["fit_rms_deg"] <= 1.2 * NOISE_DEG
    assert found["final"]["held_out_rms_deg"] <= 1.2 * NOISE_DEG


def test_small_orders_are_found_beside_a_large_one_that_a_delay_moves():
    rng = np.random.default_rng(3)
    time_s = 0.17 * np.arange(116) + rng.uniform(0.0, 0.04, 116)
    delay_s = 0.1
    late_deg = strokes_deg(time_s - delay_s, 177.0, 36.0)
    orders_deg = {2: 0.3, 4: 8.0, 12: 0.3}
    reading_deg = late_deg + rng.normal(0.0, NOISE_DEG, len(time_s))
    for order, amplitude_deg in orders_deg.items():
        reading_deg += amplitude_deg * np.sin(order * np.radians(late_deg) + order)
    poses = posed(target_deg=strokes_deg(time_s, 177.0, 36.0), reading_deg=reading_deg, time_s=time_s)
    found = found_in(poses)
    assert {effect["name"] for effect in found["effects"]} == {"latency", "stage_periodic"}
    periods = [e["parameters"]["period_deg"]["value"] for e in found["effects"] if e["name"] != "latency"]
    assert sorted(periods) == pytest.approx([360.0 / order for order in (12, 4, 2)], rel=0.01)
    (delay,) = [e["parameters"]["delay_s"] for e in found["effects"] if e["name"] == "latency"]
    assert delay["value"] == pytest.approx(delay_s, rel=0.05)
    assert found["final"]["fit_rms_deg"] <= 1.2 * NOISE_DEG


def test_what_is_accepted_of_a_late_log_is_taken_out_at_the_elevations_that_its_readings_stand_for():
    poses = three_turns(1)
    effects = [(e["name"], numbers_of(e["parameters"])) for e in found_in(poses)["effects"]]
    theta_deg, reading_deg = angles_deg(poses)
    here = circumstances(poses)
    line = fit_line_with_effects(theta_deg, reading_deg, effects, here)
    left_deg = without_effects_deg(poses, line, effects, here) - line.bias_deg - line.scale * theta_deg
    assert rms(left_deg) <= 1.2 * NOISE_DEG


def test_a_path_between_readings_is_that_of_the_stage_where_it_turns_smoothly_and_where_abruptly():
    time_s = np.arange(0.0, 60.0, 0.4)

    def swings_deg(at_s):
        return 60.0 * np.sin(0.5 * at_s) + 10.0 * np.sin(1.7 * at_s)

    for there_deg in (swings_deg, lambda at_s: strokes_deg(at_s, 60.0, 23.0)):
        motion = motion_of(posed(target_deg=there_deg(time_s), reading_deg=time_s, time_s=time_s))
        for lag_s in (0.05, 0.9):
            travelled_deg = there_deg(time_s) - there_deg(time_s - lag_s)
            inner = slice(5, -5)
            np.testing.assert_allclose(motion.travelled_deg(lag_s)[inner], travelled_deg[inner], atol=0.02)
