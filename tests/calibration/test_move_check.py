"""Moves held against what the unit felt: on runs from the simulator's physics, which shares no code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studies.blind.cells import CELLS, GRID
from studies.blind.layout import timeline
from studies.blind.physics import Cause, Noise, measure

from calrig.calibration.move_check import GYRO_WANDER_DPS, MoveWatch, gyro_move_std_deg
from calrig.calibration.poses import Pose
from calrig.plan import Plan

PLANS = {
    "default": Plan(),
    "grid": GRID,
    "random": Plan(order="random"),
    "jitter": Plan(jitter_deg=2.0),
    "ends": Plan(elevations_deg=[-60, 60], sweeps=8),
    "fine": Plan(elevations_deg=[-1, -0.5, 0, 0.5, 1], sweeps=6),
    "few": Plan(elevations_deg=[-40, 0, 40], sweeps=2),
}
SEEDS = range(4)
BACK_AND_FORTH = Plan(start_deg=-40, stop_deg=40, step_deg=20)
LONGER = Plan(start_deg=-40, stop_deg=40, step_deg=20, sweeps=6)


def uncalibrated(rng):
    """A healthy unit as it leaves its maker, on an ordinary open-loop stage: all that need not be a fault."""

    def within(size):
        return float(rng.uniform(-size, size))

    unit = {
        "gyro_scale_error_pct": [within(3), 0, 0],
        "accel_bias_mg": [within(50), within(50), within(80)],
        "accel_gain_error_pct": [within(3), within(3), within(3)],
        "accel_cross_axis_deg": {"yz": within(1.1), "zy": within(1.1)},
        "accel_cubic_mg_per_g3": [0, within(5), within(5)],
        "accel_bias_mg_per_c": [0, within(0.4), within(0.4)],
        "package_turn_deg_per_c": within(0.02),
    }
    stage = {
        "backlash_deg": abs(within(0.5)),
        "scale_error_pct": within(1),
        "worm_deg": within(0.12),
        "worm_period_deg": float(rng.uniform(4, 15)),
        "eccentricity_deg": abs(within(0.8)),
        "eccentricity_phase_deg": within(180),
        "following_std_deg": 0.02,
        "creep_fraction": abs(within(0.02)),
    }
    offset_deg = float(rng.choice([0.0, 90.0, 180.0])) + within(3)
    mount = {"offset_deg": offset_deg, "yaw_deg": within(3), "pitch_deg": within(3)}
    return Cause("none", "", "", {"imu": unit, "mechanics": stage, "mount": mount})


def losing(lost_deg, pose, when):
    """Steps lost in the midst of the move into a pose: the table ends elsewhere than the stage counts."""
    at_s = (when.move_s[pose] + when.arrival_s[pose]) / 2
    return Cause("lost", "", "", turned=lambda t, *_: np.where(t > at_s, lost_deg, 0.0), felt=True)


def judged(poses):
    """Every move of a run as it is judged, in order."""
    watch, last_deg, checks = MoveWatch(), 0.0, []
    for pose in poses:
        checks.append(watch.take(pose, pose.stage_deg - last_deg, 0.02))
        last_deg = pose.stage_deg
    return [check for check in checks if check is not None]


def run_with_loss(seed, lost_deg, chosen=PLANS["default"]):
    """A run that loses steps in its later part; its poses, and which of them tells."""
    rng = np.random.default_rng([seed, 8])
    when = timeline(chosen)
    pose = int(rng.uniform(0.3, 0.9) * len(when.target_deg))
    sense = float(rng.choice([-1, 1]))
    run = measure(chosen, [uncalibrated(rng), losing(sense * lost_deg, pose, when)], Noise(), rng)
    return run.poses, pose, sense * lost_deg


@pytest.mark.parametrize("chosen", PLANS.values(), ids=PLANS)
def test_a_healthy_uncalibrated_unit_is_accused_of_nothing(chosen):
    for seed in SEEDS:
        rng = np.random.default_rng([seed, 7])
        checks = judged(measure(chosen, [uncalibrated(rng)], Noise(), rng).poses)
        assert {check.verdict for check in checks} == {"agrees"}, seed


@pytest.mark.parametrize("cell", CELLS.values(), ids=CELLS)
def test_no_effect_that_a_diagnosis_is_tried_on_is_taken_for_lost_steps(cell):
    assert {check.verdict for check in judged(cell.run(0).poses)} == {"agrees"}


@pytest.mark.slow
@pytest.mark.parametrize("chosen", PLANS.values(), ids=PLANS)
def test_a_hundred_healthy_units_are_accused_of_nothing(chosen):
    for seed in range(1000, 1100):
        rng = np.random.default_rng([seed, 7])
        checks = judged(measure(chosen, [uncalibrated(rng)], Noise(), rng).poses)
        assert {check.verdict for check in checks} == {"agrees"}, seed


@pytest.mark.parametrize("seed", SEEDS)
def test_five_degrees_lost_in_mid_run_end_it_and_their_size_is_told(seed):
    poses, told, lost_deg = run_with_loss(seed, 5.0)
    checks = judged(poses[: told + 1])
    assert [check.verdict for check in checks[:-1]] == ["agrees"] * (len(checks) - 1)
    assert checks[-1].verdict == "lost"
    assert checks[-1].difference_deg == pytest.approx(lost_deg, abs=6 * checks[-1].std_deg)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_degree_lost_in_mid_run_is_said(seed):
    poses, told, _ = run_with_loss(seed, 1.0)
    assert judged(poses[: told + 1])[-1].verdict in {"mismatch", "lost"}


@pytest.mark.parametrize("sense", [-1, 1])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_slip_where_the_stage_stands_is_said(seed, sense):
    """At a turning point that is measured twice: neither play nor a worm explains what is felt."""
    rng = np.random.default_rng([seed, 9])
    when = timeline(BACK_AND_FORTH)
    pose = int(np.flatnonzero(np.diff(when.target_deg) == 0.0)[-1]) + 1
    causes = [uncalibrated(rng), losing(sense * 0.6, pose, when)]
    checks = judged(measure(BACK_AND_FORTH, causes, Noise(), rng).poses[: pose + 1])
    assert [check.verdict for check in checks] == ["agrees"] * (len(checks) - 1) + ["mismatch"]
    assert checks[-1].difference_deg == pytest.approx(sense * 0.6, abs=0.2)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_slip_within_a_move_of_a_regular_stage_is_said(seed):
    """After twelve poses of a stage and a unit without errors but their noise."""
    rng = np.random.default_rng([seed, 10])
    cause = losing(0.75, 12, timeline(BACK_AND_FORTH))
    checks = judged(measure(BACK_AND_FORTH, [cause], Noise(), rng).poses[:13])
    assert checks[-1].verdict == "mismatch"


def test_a_slip_that_goes_unnoticed_does_not_excuse_the_next():
    """0.4° in the thirteenth move: the tolerance of the same move two sweeps later is hardly wider for it."""
    std_deg = []
    for size_deg in (0.0, 0.4):
        rng = np.random.default_rng(11)
        cause = losing(size_deg, 12, timeline(LONGER))
        checks = judged(measure(LONGER, [cause], Noise(), rng).poses)
        assert {check.verdict for check in checks} == {"agrees"}
        std_deg.append(checks[22].std_deg)
    assert std_deg[1] < 1.25 * std_deg[0]


def test_two_in_a_row_end_a_run_that_each_alone_would_not():
    rng = np.random.default_rng(3)
    when = timeline(PLANS["default"])
    causes = [uncalibrated(rng), losing(-1.5, 30, when), losing(-1.5, 31, when)]
    checks = judged(measure(PLANS["default"], causes, Noise(), rng).poses[:32])
    assert [check.verdict for check in checks[-2:]] == ["mismatch", "lost"]


@pytest.mark.parametrize("without", ["gyro", "accelerometer", "gyro and accelerometer"])
def test_what_a_board_does_send_tells_a_loss_by_itself(without):
    missing = {}
    if "gyro" in without:
        missing["gyro_move_deg"] = None
    if "accelerometer" in without:
        missing |= {"accel_x_g": None, "accel_y_g": None, "accel_z_g": None}
    for seed in SEEDS:
        poses, told, _ = run_with_loss(seed, 5.0)
        checks = judged([replace(pose, **missing) for pose in poses[: told + 1]])
        assert {check.verdict for check in checks[:-1]} == {"agrees"}
        assert checks[-1].verdict == "lost"


def test_a_gyro_that_gravity_contradicts_accuses_no_stage():
    """A board that was reset on the way has felt one degree of ten: the unit is where the stage says."""
    rng = np.random.default_rng(5)
    poses = measure(PLANS["default"], [uncalibrated(rng)], Noise(), rng).poses
    poses[20] = replace(poses[20], gyro_move_deg=0.1 * poses[20].gyro_move_deg)
    assert {check.verdict for check in judged(poses)} == {"agrees"}


def test_the_standard_error_of_an_integrated_rate_is_its_scatter():
    """White noise and a bias known from two dwells of as noisy a gyro, against many integrals of them."""
    rng = np.random.default_rng(1)
    dwell_s, period_s, noise_dps, trials = 1.0, 0.005, 0.05, 3000
    time_s = np.arange(0.0, 4.0, period_s)
    noise = rng.normal(0.0, noise_dps, (trials, len(time_s)))
    bias_std_dps = noise_dps / np.sqrt(dwell_s / period_s)
    bias = rng.normal(0.0, bias_std_dps, (trials, 2)).mean(axis=1)
    angle_deg = np.trapezoid(noise - bias[:, None], time_s, axis=1)
    said_deg = gyro_move_std_deg(time_s, noise[0], bias_std_dps, dwell_s)
    wander_deg = GYRO_WANDER_DPS * 4.0
    assert said_deg == pytest.approx(np.hypot(angle_deg.std(), wander_deg), rel=0.05)


def test_a_step_of_the_rate_between_two_samples_is_unknown_by_a_rectangular_error():
    """Simulated: the rate steps from 0 to 60 °/s at any moment between two samples, summed by trapezia."""
    at_s = np.random.default_rng(26).uniform(0.0, 0.1, 100_000)
    error_deg = 60.0 * (0.1 - at_s) - 60.0 * 0.1 / 2.0
    stated_deg = gyro_move_std_deg(np.array([0.0, 0.1]), np.array([0.0, 60.0]), 0.0, 2.0)
    assert stated_deg == pytest.approx(error_deg.std(), rel=0.01)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("lost_deg", "verdict"), [(1.7, "mismatch"), (-1.7, "mismatch"), (2.4, "lost")])
def test_one_loss_ends_a_run_from_two_degrees_on(seed, lost_deg, verdict):
    """After twelve poses of a stage and a unit without errors but their noise."""
    rng = np.random.default_rng([seed, 12])
    cause = losing(lost_deg, 12, timeline(BACK_AND_FORTH))
    checks = judged(measure(BACK_AND_FORTH, [cause], Noise(), rng).poses[:13])
    assert checks[-1].verdict == verdict
    assert checks[-1].difference_deg == pytest.approx(lost_deg, abs=0.3)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_backlash_is_learned_from_two_reversals_and_predicted_at_the_next(seed):
    """Of 0.7°: the first reversal shows all of it, later ones nothing, neither up nor down."""
    rng = np.random.default_rng([seed, 13])
    stage = Cause("none", "", "", {"mechanics": {"backlash_deg": 0.7}})
    poses = measure(LONGER, [stage], Noise(), rng).poses
    checks = judged(poses)
    reversals = [k for k in range(1, len(poses)) if poses[k].approach == -poses[k - 1].approach]
    first, *later = (checks[k - len(poses) + len(checks)].difference_deg for k in reversals)
    assert abs(first) == pytest.approx(0.7, abs=0.2)
    assert later[1:] == pytest.approx([0.0] * len(later[1:]), abs=0.15)


def test_an_unknown_backlash_widens_the_first_reversal_by_its_rectangular_prior():
    """A play of up to ±0.75° turns all of it at a reversal; it adds to both witnesses alike (GUM 4.3.7)."""
    variances = []
    for approach in (1, -1):
        watch = MoveWatch()
        watch.take(Pose(20.0, 20.0, approach=1, gyro_move_deg=20.0), 20.0)
        check = watch.take(Pose(10.0, 10.0, approach=approach, gyro_move_deg=-10.0), -10.0)
        variances.append(check.std_deg**2)
    assert variances[1] - variances[0] == pytest.approx(0.75**2 / 3.0)


def differences_deg(theta_deg, reading_deg, gyro_deg, *, with_gravity):
    """What a watch leaves unexplained of each move but the first, of a board that sends its own angle."""
    watch, left, last_deg = MoveWatch(), [], 0.0
    for theta, reading, felt in zip(theta_deg, reading_deg, gyro_deg, strict=True):
        if not with_gravity:
            watch.touched()
        check = watch.take(Pose(theta, reading, stage_deg=theta, gyro_move_deg=felt), theta - last_deg)
        last_deg = theta
        left.append(check.difference_deg)
    return np.array(left[1:])


def test_a_share_of_each_move_that_has_not_settled_is_learned():
    """An exact stage and gyro; each reading lacks 5 % of the move into its pose."""
    theta_deg = np.random.default_rng(14).uniform(-50.0, 50.0, 16)
    move_deg = np.diff(theta_deg, prepend=0.0)
    left_deg = differences_deg(theta_deg, theta_deg - 0.05 * move_deg, move_deg, with_gravity=True)
    np.testing.assert_allclose(left_deg[-5:], 0.0, atol=0.03)


def test_an_eccentric_stage_is_learned_from_the_gyro_alone():
    """The table stands at θ + 0.8°·sin θ where the stage says θ."""
    theta_deg = np.random.default_rng(15).uniform(-90.0, 90.0, 16)
    table_deg = theta_deg + 0.8 * np.sin(np.radians(theta_deg))
    felt_deg = np.diff(table_deg, prepend=0.0)
    left_deg = differences_deg(theta_deg, table_deg, felt_deg, with_gravity=False)
    np.testing.assert_allclose(left_deg[-5:], 0.0, atol=0.1)


def test_what_both_witnesses_share_does_not_hide_that_they_contradict_each_other():
    """At the first reversal the backlash is unknown to both; the gyro is off by 0.8°, gravity is not."""
    watch = MoveWatch()
    moves = [(5.0, 1, 2.0, 2.0), (3.0, -1, -2.0, -1.2)]
    for theta_deg, approach, turned_deg, gyro_deg in moves:
        y, z = np.sin(np.radians(theta_deg)), np.cos(np.radians(theta_deg))
        pose = Pose(theta_deg, theta_deg, approach=approach, gyro_move_deg=gyro_deg, accel_y_g=y, accel_z_g=z)
        check = watch.take(pose, turned_deg)
    assert check.difference_deg == pytest.approx(0.0, abs=0.02)
