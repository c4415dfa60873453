"""Profiles, play and creep against brute force that knows nothing of segments."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calrig.simulator.config import MechanicsOptions
from calrig.simulator.mechanics import Mechanics, through_play
from calrig.simulator.trajectory import Segment, Trajectory, braking, trapezoid

ANGLES = st.floats(-170, 170)
VELOCITIES = st.floats(0.5, 100)
ACCELERATIONS = st.floats(1, 500)
STEP_S = 1e-3


def mechanics(**options) -> Mechanics:
    return Mechanics(MechanicsOptions(**options), np.random.default_rng(0))


def tour(stage: Mechanics, targets_deg: list[float], halts: list[bool]) -> float:
    """Homes and visits targets, halting some moves half-way; returns the instant at which it ends."""
    now_s = stage.home(0.5, 20.0, 80.0).at_s + 0.1
    for target_deg, halted in zip(targets_deg, halts, strict=True):
        arrive_s = stage.move(now_s, target_deg, 30.0, 90.0).at_s
        now_s = (stage.halt((now_s + arrive_s) / 2, 90.0) if halted else arrive_s) + 0.05
    return now_s


@given(ANGLES, ANGLES, VELOCITIES, ACCELERATIONS)
def test_a_move_arrives_at_rest_within_velocity_and_acceleration(start, target, velocity, acceleration):
    way = trapezoid(2.0, start, target, velocity, acceleration)
    motion = Trajectory(start)
    motion.replace_from(2.0, way)
    times_s, dt = np.linspace(2.0, way[-1].start_s, 500, retstep=True)
    angle_deg, rate_dps = motion.at(times_s)

    assert way[-1] == Segment(way[-1].start_s, target)
    assert np.abs(rate_dps).max() <= velocity * (1 + 1e-9)
    assert np.abs(np.diff(rate_dps)).max() <= acceleration * dt * (1 + 1e-6) + 1e-9
    assert angle_deg[0] == pytest.approx(start)
    assert angle_deg[-1] == pytest.approx(target)
    turned_deg = (rate_dps[1:] + rate_dps[:-1]) / 2 * dt
    assert np.abs(np.diff(angle_deg) - turned_deg).max() <= acceleration * dt**2 + 1e-9


def test_a_long_move_takes_way_over_velocity_plus_one_ramp():
    assert trapezoid(0.0, 0.0, 60.0, 20.0, 80.0)[-1].start_s == pytest.approx(60 / 20 + 20 / 80)


@given(VELOCITIES, ACCELERATIONS)
def test_braking_takes_the_way_that_velocity_and_acceleration_give(velocity, acceleration):
    rest = braking(1.0, 10.0, -velocity, acceleration)[-1]
    assert rest.position_deg == pytest.approx(10.0 - velocity**2 / (2 * acceleration))
    assert rest.start_s == pytest.approx(1.0 + velocity / acceleration)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(-20, 20), st.booleans()), min_size=1, max_size=6), st.floats(0.0, 3.0))
def test_the_follower_is_the_play_operator_of_the_motor(visits, gap_deg):
    stage = mechanics(backlash_deg=gap_deg)
    end_s = tour(stage, [target for target, _ in visits], [halted for _, halted in visits])
    times_s = np.arange(0.0, end_s, STEP_S)
    motor_deg = stage.motor(times_s).angle_deg

    follower_deg = np.empty_like(motor_deg)
    at_deg = motor_deg[0]
    for k, pushed_deg in enumerate(motor_deg):
        at_deg = min(max(at_deg, pushed_deg - gap_deg / 2), pushed_deg + gap_deg / 2)
        follower_deg[k] = at_deg

    # Between two steps the motor turns by at most 30 mdeg, which is where brute force may miss a reversal.
    np.testing.assert_allclose(stage.table(times_s).angle_deg, follower_deg, atol=0.031)
    standing = np.abs(np.gradient(motor_deg)) < 1e-12
    np.testing.assert_allclose(stage.table(times_s).angle_deg[standing], follower_deg[standing], atol=1e-3)


@pytest.mark.parametrize(("approach", "start_deg"), [(+1, 0.0), (-1, 20.0)])
def test_the_table_lags_its_motor_by_half_the_gap(approach, start_deg):
    stage = mechanics(backlash_deg=0.12)
    now_s = stage.home(0.0, 20.0, 80.0).at_s
    now_s = stage.move(now_s, start_deg, 20.0, 80.0).at_s
    now_s = stage.move(now_s, 10.0, 20.0, 80.0).at_s
    assert stage.table(np.array([now_s])).angle_deg[0] == pytest.approx(10.0 - approach * 0.06)


def test_a_reversal_smaller_than_the_gap_does_not_move_the_table():
    stage = mechanics(backlash_deg=0.5)
    now_s = stage.home(0.0, 20.0, 80.0).at_s
    before_deg = stage.table(np.array([now_s])).angle_deg[0]
    now_s = stage.move(now_s, -0.4, 20.0, 80.0).at_s
    assert stage.table(np.array([now_s])).angle_deg[0] == before_deg


def test_a_motor_that_stands_in_the_gap_pushes_nothing():
    assert through_play([Segment(0.0, 5.0)], 5.1, 0.4) == [Segment(0.0, 5.1)]


def test_creep_is_a_first_order_lag_of_the_motion():
    fraction, tau_s = 0.2, 0.7
    stage = mechanics(creep_fraction=fraction, creep_s=tau_s)
    end_s = tour(stage, [15.0, -10.0, 3.0], [False, True, False]) + 2.0
    times_s = np.arange(0.0, end_s, 1e-4)
    motor_deg = stage.motor(times_s).angle_deg
    lagged_deg = np.empty_like(motor_deg)
    at_deg, keep = motor_deg[0], np.exp(-1e-4 / tau_s)
    for k, target_deg in enumerate(motor_deg):
        at_deg = target_deg + (at_deg - target_deg) * keep
        lagged_deg[k] = at_deg
    expected_deg = motor_deg - fraction * (motor_deg - lagged_deg)
    np.testing.assert_allclose(stage.table(times_s).angle_deg, expected_deg, atol=2e-3)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"scale_error_pct": 2.0},
        {"backlash_deg": 0.5},
        {"eccentricity_deg": 0.4, "eccentricity_phase_deg": 50.0},
        {"worm_deg": 0.05, "worm_period_deg": 7.2},
        {"detent_share": 0.1, "motor_step_deg": 1.8},
        {"creep_fraction": 0.1, "creep_s": 0.5},
    ],
)
def test_the_rate_is_the_derivative_of_the_angle_whatever_the_gear(options):
    stage = mechanics(**options)
    end_s = tour(stage, [25.0, -8.0, 11.0], [False, True, False])
    times_s = np.linspace(0.0, end_s, 200_001)
    angle_deg, rate_dps = stage.table(times_s)
    turned_deg = np.concatenate([[0.0], np.cumsum((rate_dps[1:] + rate_dps[:-1]) / 2 * np.diff(times_s))])
    np.testing.assert_allclose(turned_deg, angle_deg - angle_deg[0], atol=2e-3)


@given(st.floats(-60, 60), st.floats(0, 5), st.floats(-180, 180))
def test_eccentricity_and_gear_do_what_their_formulae_say(target, amplitude, phase):
    stage = mechanics(scale_error_pct=1.5, eccentricity_deg=amplitude, eccentricity_phase_deg=phase)
    now_s = stage.move(stage.home(0.0, 90.0, 900.0).at_s, target, 90.0, 900.0).at_s
    geared = 1.015 * target
    expected = geared + amplitude * np.sin(np.radians(geared + phase))
    assert stage.table(np.array([now_s])).angle_deg[0] == pytest.approx(expected, abs=1e-9)


def test_the_worm_repeats_every_period_and_vanishes_twice_in_it():
    stage = mechanics(worm_deg=0.04, worm_period_deg=8.0, worm_phase_deg=0.0)
    now_s = stage.home(0.0, 90.0, 900.0).at_s
    errors_deg = []
    for target in (0.0, 2.0, 4.0, 6.0, 8.0, 10.0):
        now_s = stage.move(now_s, target, 90.0, 900.0).at_s
        errors_deg.append(stage.table(np.array([now_s])).angle_deg[0] - target)
    np.testing.assert_allclose(errors_deg, [0, 0.04, 0, -0.04, 0, 0.04], atol=1e-12)


def test_detents_hold_a_motor_off_by_a_wave_of_a_full_step():
    """Balance of torques: to first order by share·step·2/π at most, and not at all on a step."""
    stage = mechanics(detent_share=0.08, motor_step_deg=1.8)
    now_s = stage.home(0.0, 90.0, 900.0).at_s
    off_deg = []
    for target in np.linspace(0.0, 3.6, 33):
        now_s = stage.move(now_s, target, 90.0, 900.0).at_s
        off_deg.append(stage.table(np.array([now_s])).angle_deg[0] - target)
    assert max(off_deg) == pytest.approx(0.08 * 1.8 * 2.0 / np.pi, rel=0.1)
    np.testing.assert_allclose(off_deg[:17], off_deg[16:], atol=1e-9)
    np.testing.assert_allclose(off_deg[::16], 0.0, atol=1e-9)


def test_an_encoder_on_the_motor_sees_no_backlash_and_one_on_the_table_does():
    shown_deg = {}
    for place in ("motor", "table"):
        stage = mechanics(backlash_deg=0.2, encoder_on=place)
        now_s = stage.home(0.0, 20.0, 80.0).at_s
        now_s = stage.move(now_s, 10.0, 20.0, 80.0).at_s
        now_s = stage.move(now_s, 5.0, 20.0, 80.0).at_s
        shown_deg[place] = stage.encoder_deg(np.array([now_s]))[0]
    assert shown_deg["motor"] == pytest.approx(5.0)
    assert shown_deg["table"] == pytest.approx(5.2)


def test_the_encoder_counts_whole_steps():
    stage = mechanics(encoder_resolution_deg=0.25)
    now_s = stage.move(stage.home(0.0, 20.0, 80.0).at_s, 10.1, 20.0, 80.0).at_s
    assert stage.encoder_deg(np.array([now_s]))[0] == pytest.approx(10.0)
    assert stage.table(np.array([now_s])).angle_deg[0] == pytest.approx(10.1)


def test_following_error_is_in_the_table_and_in_the_encoder_alike():
    stage = mechanics(following_std_deg=0.05, following_lag_s=0.2)
    now_s = stage.home(0.0, 20.0, 80.0).at_s
    arrive_s = stage.move(now_s, 40.0, 20.0, 80.0).at_s
    ended = np.array([arrive_s])
    assert stage.table(ended).angle_deg[0] != 40.0
    assert stage.table(ended).angle_deg[0] == pytest.approx(40.0, abs=0.3)
    assert stage.encoder_deg(ended)[0] == pytest.approx(stage.table(ended).angle_deg[0], abs=1e-9)
    assert stage.motor(np.array([now_s + 0.19])).rate_dps[0] == 0.0


def test_homing_again_moves_the_zero_by_what_it_fails_to_repeat():
    stage = mechanics(homing_std_deg=0.1)
    zeros_deg = []
    now_s = 0.0
    for _ in range(50):
        now_s = stage.home(now_s, 90.0, 900.0).at_s
        zeros_deg.append(stage.table(np.array([now_s])).angle_deg[0])
        assert stage.encoder_deg(np.array([now_s]))[0] == pytest.approx(0.0, abs=1e-9)
    assert np.std(zeros_deg) == pytest.approx(0.1, rel=0.4)


def test_an_obstruction_stops_the_motor_where_it_is_and_lets_it_go_back():
    stage = mechanics(obstruction_deg=20.0)
    now_s = stage.home(0.0, 20.0, 80.0).at_s
    into = stage.move(now_s, 40.0, 20.0, 80.0)
    assert into.stalled
    assert stage.motor(np.array([into.at_s + 9])).angle_deg[0] == pytest.approx(20.0)
    assert stage.move(into.at_s, 30.0, 20.0, 80.0) == (into.at_s, True)
    assert not stage.move(into.at_s, 5.0, 20.0, 80.0).stalled


def test_a_table_is_off_by_as_many_orders_as_it_is_told():
    waves = [{"order": 1, "amplitude_deg": 0.2, "phase_deg": 30}, {"order": 5, "amplitude_deg": 0.1}]
    stage = mechanics(harmonics=waves)
    ready_s = stage.move(stage.home(0.0, 90.0, 900.0).at_s, 50.0, 20.0, 80.0).at_s
    expected = 50.0 + 0.2 * np.sin(np.radians(80)) + 0.1 * np.sin(np.radians(250))
    assert stage.table(np.array([ready_s])).angle_deg[0] == pytest.approx(expected)
    times_s = np.linspace(0.0, ready_s, 20_001)
    table = stage.table(times_s)
    np.testing.assert_allclose(np.gradient(table.angle_deg, times_s)[5:-5], table.rate_dps[5:-5], atol=0.2)
