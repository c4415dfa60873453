"""Poses of a sweep are means over stretches of its way: what is left there of a wave, and of a slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.effects import EFFECTS
from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.regression.motion import behind, stretches_deg
from calrig.calibration.regression.responses import responses_of
from calrig.calibration.results.correction import effects_on_reading_deg
from calrig.calibration.results.pose_errors import circumstances
from calrig.calibration.uncertainty.sequential_stopping import turned_both_ways
from calrig.plan import Plan

VELOCITY_DPS, NOISE_DEG, GYRO_NOISE_DEG = 4.0, 0.01, 0.006
PLAN = Plan(kind="sweep", sweeps=3, step_deg=8.0, velocity_dps=VELOCITY_DPS, dwell_s=2.0, jitter_deg=1.0)


def swept(table_deg, seed=1):
    """Poses of a sweep; `table_deg` of time and the motor's angle is where the table is, felt by the gyro."""
    rng = np.random.default_rng(seed)
    poses, now_s, before = [], 0.0, None
    for one in PLAN.poses((-90.0, 90.0)):
        ends_deg = one.stretch_deg or (one.target_deg,) * 2
        lasts_s = abs(ends_deg[1] - ends_deg[0]) / VELOCITY_DPS if one.stretch_deg else PLAN.dwell_s
        if one.stretch_deg is None:
            now_s += 0.5
        share = (np.arange(200) + 0.5) / 200
        read_deg = table_deg(
            now_s + share * lasts_s, ends_deg[0] + share * (ends_deg[1] - ends_deg[0])
        ).mean()
        middle_s = now_s + (0.5 * lasts_s if one.stretch_deg else 0.0)
        stands_deg = float(table_deg(np.array([middle_s]), np.array([one.target_deg]))[0])
        felt_deg = None if before is None else stands_deg - before + GYRO_NOISE_DEG * rng.standard_normal()
        accel_deg = read_deg + 0.5 * NOISE_DEG * rng.standard_normal()
        poses.append(
            Pose(
                target_deg=one.target_deg,
                reading_deg=float(read_deg + NOISE_DEG * rng.standard_normal()),
                sweep=one.sweep,
                approach=-1 if one.sweep % 2 else 1,
                time_s=now_s + 0.5 * lasts_s,
                n_samples=round(200.0 * lasts_s),
                accel_y_g=float(np.sin(np.radians(accel_deg)) * (1.0 + 2e-4 * rng.standard_normal())),
                accel_z_g=float(np.cos(np.radians(accel_deg)) * (1.0 + 2e-4 * rng.standard_normal())),
                gyro_move_deg=felt_deg,
                settle_s=None if one.stretch_deg else 0.2,
                filtering=Filtering(remembers=False),
            )
        )
        now_s, before = now_s + lasts_s, stands_deg if one.stretch_deg else float(read_deg)
    return poses


def found_in(poses):
    return document(diagnose([poses], bootstraps=99, cross_fit=False), ["1"])["effects"]


def test_a_stretch_is_as_long_as_its_samples_last_and_a_dwell_has_no_length():
    planned = PLAN.poses((-90.0, 90.0))
    ways_deg = [abs(np.subtract(*one.stretch_deg)) if one.stretch_deg else 0.0 for one in planned]
    poses = swept(lambda _s, motor_deg: motor_deg)
    assert stretches_deg(poses) == pytest.approx(ways_deg, abs=0.1)
    assert not stretches_deg([replace(pose, filtering=None) for pose in poses]).any()


def test_a_worm_that_stretches_hardly_show_is_found_at_its_whole_size():
    """Of a period of 6.5° a mean over 8° keeps a sixth, with its sign turned."""
    poses = swept(lambda _s, motor_deg: motor_deg + 0.04 * np.sin(2 * np.pi * motor_deg / 6.5))
    (effect,) = found_in(poses)
    assert (effect["name"], effect["verdict"]) == ("stage_periodic", "named")
    for name, true in (("amplitude_deg", 0.04), ("period_deg", 6.5)):
        stated = effect["parameters"][name]
        assert stated["value"] == pytest.approx(true, abs=4.0 * stated["std"])


WAVE = {"amplitude_deg": 1.0, "phase_deg": 90.0, "period_deg": 6.5}
CREEP = {"fraction": 1.0, "lag_s": 1.5}


@pytest.mark.parametrize(("name", "parameters"), [("stage_periodic", WAVE), ("settling", CREEP)])
def test_what_is_taken_out_of_a_stretch_is_what_was_fitted_to_it(name, parameters):
    poses = swept(lambda _s, motor_deg: motor_deg)
    r = responses_of([poses])
    (shape,) = EFFECTS[name].forms(r, parameters)
    taken_deg = effects_on_reading_deg([(name, parameters)], r.theta_deg, circumstances(poses))
    column = shape.shares["reading"].reshape(len(r), -1)[:, -1]  # of a wave at 90° the cosine
    np.testing.assert_allclose(taken_deg, column, atol=1e-12)


def test_a_slip_within_a_stretch_is_what_the_gyro_felt_and_a_part_of_its_mean():
    slips_s = 41.3
    poses = swept(lambda time_s, motor_deg: motor_deg + 0.06 * (time_s > slips_s))
    (effect,) = found_in(poses)
    assert (effect["name"], effect["verdict"]) == ("mount_slip", "named")
    step, at = effect["parameters"]["step_deg"], effect["parameters"]["at_s"]
    assert step["value"] == pytest.approx(0.06, abs=4.0 * step["std"])
    assert at["value"] == pytest.approx(slips_s, abs=2.0)


def test_one_way_of_a_sweep_is_not_enough_for_a_line():
    poses = swept(lambda _s, motor_deg: motor_deg)
    ends = [k for k, pose in enumerate(poses) if pose.settled]
    assert [turned_both_ways(poses[: k + 1]) for k in ends] == [True, False, True, True]


def behind_its_motor(lag_s, fraction):
    """Where a table is that misses a share of each turn, ever less of it with time."""
    rate_hz = 100.0
    planned = PLAN.poses((-90.0, 90.0))
    motor_deg = [np.full(int(PLAN.dwell_s * rate_hz), planned[0].target_deg)]
    for sweep in range(PLAN.sweeps):
        ends_deg = [-60.0, 60.0] if sweep % 2 == 0 else [60.0, -60.0]
        motor_deg.append(np.linspace(*ends_deg, int(120.0 / VELOCITY_DPS * rate_hz)))
        motor_deg.append(np.full(int((0.5 + PLAN.dwell_s) * rate_hz), ends_deg[1]))
    at_deg = np.concatenate(motor_deg)
    step_deg = np.diff(at_deg, prepend=at_deg[0])
    missing_deg = lfilter([1.0], [1.0, -np.exp(-1.0 / rate_hz / lag_s)], step_deg)
    times_s = np.arange(len(at_deg)) / rate_hz + 0.5  # a dwell begins half a second after its turn
    return lambda time_s, motor: motor - fraction * np.interp(time_s, times_s, missing_deg)


def test_what_creeps_behind_the_turning_motor_is_no_backlash():
    (effect,) = found_in(swept(behind_its_motor(1.5, 0.01)))
    assert (effect["name"], effect["verdict"]) == ("settling", "named")
    assert effect["parameters"]["lag_s"]["value"] == 1.5
    assert effect["parameters"]["fraction"]["value"] == pytest.approx(0.01, rel=0.2)


def test_the_gyro_feels_a_slip_before_the_middle_of_a_stretch_or_in_the_next_move():
    r = responses_of([swept(lambda _s, motor_deg: motor_deg)])
    effect, stretch, dwell = EFFECTS["mount_slip"], 5, int(np.flatnonzero(r.stretch_deg == 0.0)[1])

    def felt_at(pose, part):
        at = {"at_s": float(r.time_s[pose]), "pose": float(pose), "part": part}
        (shape,) = (one for one in effect.forms(r, at) if one.form.startswith("in a"))
        assert shape.shares["reading"][pose] == part
        return np.flatnonzero(shape.shares.get("gyro_move", np.zeros(1))).tolist()

    assert [felt_at(stretch, part) for part in (0.8, 0.2)] == [[stretch], [stretch + 1]]
    assert felt_at(dwell, 0.8) == []


def test_what_the_gyros_bias_of_a_pass_is_wrong_by_is_no_noise_of_its_moves():
    """A slip of 0.06° in a dwell of 2 s is 0.03°/s of bias there, and half of it in the passes beside it."""
    poses = swept(lambda _s, motor_deg: motor_deg)
    wrong = [
        pose if pose.sweep == 0 else replace(pose, gyro_move_deg=pose.gyro_move_deg - 0.03) for pose in poses
    ]
    r = responses_of([wrong])
    move = r.channels.index("gyro_move")
    assert [name for name in r.base_names if name == "gyro_move.bias"] == ["gyro_move.bias"] * PLAN.sweeps
    fitted, *_ = np.linalg.lstsq(r.base[:, move], r.values[:, move], rcond=None)
    left_deg = (r.values[:, move] - r.base[:, move] @ fitted)[r.known[:, move]]
    assert left_deg.std() < 1.3 * GYRO_NOISE_DEG
    standing = responses_of([[replace(pose, settle_s=1.0) for pose in poses]])
    assert standing.base_names.count("gyro_move.bias") == 1


def test_what_creeps_behind_a_sweep_is_a_first_order_lag_integrated_step_by_step():
    """A dwell, five segments of 1.2 s at 5 °/s, a dwell, one back: the means, and the growth between them."""
    pace_dps, lag_s, lasts_s = 5.0, 0.8, 1.2
    fine_s = np.arange(-2.0, 20.0, 1e-4)
    begins_s, ends_s = 3.0, 11.0
    stage_deg = pace_dps * (np.clip(fine_s, begins_s, ends_s) - np.clip(fine_s, 15.0, 18.0))
    decay = np.exp(-1e-4 / lag_s)
    creep_deg = lfilter([decay], [1.0, -decay], np.diff(stage_deg, prepend=stage_deg[0]))
    time_s = np.array([1.0, 4.0, 5.5, 7.0, 8.5, 10.0, 13.0, 16.0])
    turning = np.array([False, True, True, True, True, True, False, True])
    theta_deg = np.interp(time_s, fine_s, stage_deg)

    found = behind(time_s, theta_deg, np.where(turning, pace_dps * lasts_s, 0.0), time_s == 1.0, lag_s)

    def at(moment_s):
        return np.interp(moment_s, fine_s, creep_deg)

    mean_deg = [creep_deg[np.abs(fine_s - t) <= lasts_s / 2.0].mean() for t in time_s]
    from_s = np.where(turning, time_s, time_s + lasts_s / 2.0)[:-1]
    to_s = np.where(turning, time_s, time_s - lasts_s / 2.0)[1:]
    np.testing.assert_allclose(found.mean_deg, mean_deg, atol=2e-3)
    np.testing.assert_allclose(found.grown_deg, [0.0, *(at(to_s) - at(from_s))], atol=2e-3)
