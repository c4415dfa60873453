"""What columns tell of motion: a velocity of a log taken on the move, moves where there was a history."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from posed import posed

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.poses import Pose
from calrig.calibration.regression.motion import approach_of, motion_of, moves_deg
from calrig.calibration.regression.responses import responses_of

SPEED_DPS = 36.0
DELAY_S = 0.035


def stroke_deg(time_s):
    """Elevation of a table that goes to and fro over 120° without a stop."""
    turn_s = 120.0 / SPEED_DPS
    return 60.0 - SPEED_DPS * np.abs(np.mod(time_s, 2.0 * turn_s) - turn_s)


def on_the_move(time_s, elevation_deg=stroke_deg, **known):
    rng = np.random.default_rng(3)
    return [
        Pose(
            target_deg=float(elevation_deg(t)),
            reading_deg=0.3 + float(elevation_deg(t - DELAY_S) + rng.normal(0.0, 0.05)),
            time_s=float(t),
            **known,
        )
        for t in time_s
    ]


EVEN_S = 0.1 + 0.2 * np.arange(120)
UNEVEN_S = EVEN_S + np.random.default_rng(1).uniform(-0.05, 0.05, len(EVEN_S))


@pytest.mark.parametrize("time_s", [EVEN_S, UNEVEN_S], ids=["even", "uneven"])
@pytest.mark.parametrize("lag_s", [0.002, 0.035, 0.1, -0.035])
def test_the_mean_velocity_over_a_delay_is_that_of_the_way_gone_in_it(time_s, lag_s):
    """Also at the poses next to a reversal."""
    motion = motion_of(on_the_move(time_s))
    way_deg = stroke_deg(time_s) - stroke_deg(time_s - lag_s)
    inner = slice(2, -2)
    np.testing.assert_allclose(motion.mean_dps(lag_s)[inner], (way_deg / lag_s)[inner], atol=1e-6)


def test_a_velocity_that_changes_smoothly_is_the_derivative_of_the_elevation():
    poses = on_the_move(EVEN_S, lambda t: 60.0 * np.sin(0.4 * t))
    error_dps = motion_of(poses).velocity_dps - 24.0 * np.cos(0.4 * EVEN_S)
    assert np.abs(error_dps[1:-1]).max() < 0.01 * 24.0


@pytest.mark.parametrize("known", [{"reading_std_deg": 0.1}, {"n_samples": 40}, {"settle_s": 1.0}])
def test_poses_that_stood_have_moves_and_no_velocity(known):
    poses = on_the_move(EVEN_S, **known)
    assert motion_of(poses) is None
    np.testing.assert_allclose(moves_deg(poses)[1:], np.diff(stroke_deg(EVEN_S)))


def test_readings_too_far_apart_to_have_been_taken_on_the_move_stood():
    assert motion_of(on_the_move(20.0 * EVEN_S)) is None


def test_a_log_taken_on_the_move_tells_the_sense_of_its_motion_and_has_no_moves():
    poses = on_the_move(UNEVEN_S)
    np.testing.assert_array_equal(
        approach_of(poses), np.sign(stroke_deg(UNEVEN_S) - stroke_deg(UNEVEN_S - 1e-5))
    )
    assert np.isnan(moves_deg(poses)).all()


def test_rows_at_uneven_angles_that_go_on_one_way_were_come_to_that_way():
    """A smooth motion through them would swing back where two lie close together."""
    up_deg = np.sort(np.random.default_rng(5).uniform(0.0, 360.0, 300))
    theta_deg = np.concatenate([up_deg, up_deg[-2::-1]])
    poses = posed(target_deg=theta_deg, reading_deg=theta_deg, time_s=1.5 * np.arange(len(theta_deg)))
    assert motion_of(poses) is not None
    up = np.diff(theta_deg, append=-1.0) > 0.0  # the turning point itself has no way of its own
    np.testing.assert_array_equal(approach_of(poses)[up], 1.0)
    np.testing.assert_array_equal(approach_of(poses)[300:], -1.0)


def test_readings_that_come_late_in_a_log_without_velocities_are_traced_to_their_delay():
    """At one speed a backlash looks the same, but for a few readings next to abrupt reversals."""
    (effect,) = document(diagnose([on_the_move(UNEVEN_S)], bootstraps=199, cross_fit=False), ["1"])["effects"]
    assert (effect["name"], effect["confusable_with"]) == ("latency", ["backlash"])
    delay = effect["parameters"]["delay_s"]
    assert delay["value"] == pytest.approx(DELAY_S, abs=4.0 * delay["std"])


def turn(count=72, **columns):
    """A table of a sensor's errors over one turn, from 0° up, across ±180° and up to 0° again."""
    angle_deg = np.mod(np.arange(count) * 360.0 / count + 180.0, 360.0) - 180.0
    rng = np.random.default_rng(0)
    reading = angle_deg + rng.normal(0.0, 0.05, count)
    reading[count // 2 :] += 2.0 * np.exp(
        -np.arange(count - count // 2)
    )  # an error that a move would explain
    return [
        Pose(float(angle_deg[k]), float(reading[k]), **{n: float(v[k]) for n, v in columns.items()})
        for k in range(count)
    ]


def test_the_order_of_rows_is_no_history_unless_a_column_says_so():
    r = responses_of([turn()])
    assert np.abs(r.move_deg).max() == 0.0
    assert not [name for name in r.base_names if name.endswith(".first")]
    assert any(warning.startswith("no column time_s") for warning in r.warnings)
    effects = document(diagnose([turn()], bootstraps=199, cross_fit=False), ["1"])["effects"]
    assert not {e["name"] for e in effects} & {"settling", "gyro_scale", "backlash", "mount_slip"}


def test_a_move_across_the_half_turn_is_the_short_way():
    np.testing.assert_allclose(moves_deg(turn(time_s=10.0 * np.arange(72)))[1:], 5.0)


def test_a_stage_that_says_it_went_the_long_way_round_did():
    there_and_back = [Pose(t, t, approach=a) for t, a in [(-170.0, 1), (170.0, 1), (-170.0, -1), (170.0, -1)]]
    np.testing.assert_allclose(moves_deg(there_and_back)[1:], [340.0, -340.0, -20.0])


def test_turns_that_are_counted_are_moves_as_they_stand():
    eleven = [replace(pose, target_deg=330.0 * k, approach=1) for k, pose in enumerate(turn(12))]
    np.testing.assert_allclose(moves_deg(eleven)[1:], 330.0)
