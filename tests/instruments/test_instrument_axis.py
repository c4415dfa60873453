from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted_stage import Clock, ScriptedStage

from calrig.instruments import standstill
from calrig.instruments.axis import Axis, Motion, travel_time_s
from calrig.instruments.errors import Halted, LimitError, PortBlocked, StageError
from calrig.instruments.stages.smc100.driver import Smc100


@pytest.fixture
def stage():
    return ScriptedStage()


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def axis(stage, clock):
    axis = Axis(stage, limits_deg=(-90.0, 90.0), tolerance_deg=0.3, clock=clock)
    axis.identify()
    return axis


@given(
    elevation=st.floats(-90, 90),
    zero=st.floats(-180, 180),
    sign=st.sampled_from([-1, 1]),
    ratio=st.floats(0.1, 100),
)
def test_elevation_is_sign_times_stage_less_zero_over_ratio(elevation, zero, sign, ratio):
    stage = ScriptedStage()
    axis = Axis(stage, zero_deg=zero, sign=sign, ratio=ratio)
    axis.begin_move(elevation)
    ((_, stage.at_deg),) = stage.sent
    assert sign * (stage.at_deg - zero) / ratio == pytest.approx(elevation, abs=1e-9)
    assert axis.elevation_deg() == pytest.approx(elevation, abs=1e-9)


@pytest.mark.parametrize("beyond", [90.001, -90.001, math.inf, -math.inf, math.nan])
def test_a_target_beyond_the_soft_limits_never_reaches_the_stage(axis, stage, beyond):
    with pytest.raises(LimitError, match=r"soft limits -90° to 90°.*nothing was sent"):
        axis.begin_move(beyond)
    assert stage.sent == []


def test_the_controllers_own_limits_narrow_the_soft_ones():
    axis = Axis(ScriptedStage((-20.0, 100.0)), zero_deg=10.0, sign=-1, ratio=2.0, limits_deg=(-30.0, 30.0))
    axis.identify()
    assert axis.limits_deg == (-30.0, 15.0)
    with pytest.raises(LimitError, match="rig and controller together"):
        axis.begin_move(20.0)


def test_limits_that_leave_nothing_are_said():
    axis = Axis(ScriptedStage((100.0, 120.0)), limits_deg=(-30.0, 30.0))
    with pytest.raises(StageError, match=r"100° to 120° only.*check zero_deg, sign and ratio"):
        axis.identify()


def test_a_move_is_over_when_the_stage_is_ready_at_its_target(axis, stage):
    axis.begin_move(20.0)
    stage.state, stage.at_deg = "moving", 7.0
    assert axis.poll() == Motion(7.0, moving=True)
    stage.state, stage.at_deg = "ready", 20.1
    assert axis.poll() == Motion(20.1, moving=False)


def test_a_move_to_where_it_already_is_is_over_at_once(axis, stage):
    axis.begin_move(0.0)
    assert axis.poll() == Motion(0.0, moving=False)


def test_a_move_that_has_not_begun_yet_gets_a_moment(axis, stage, clock):
    axis.begin_move(20.0)
    assert axis.poll().moving
    clock.at_s += 0.9
    assert axis.poll().moving
    clock.at_s += 0.2
    with pytest.raises(StageError, match=r"20°.*0\.000°.*READY"):
        axis.poll()


def test_a_move_that_ends_elsewhere_fails(axis, stage, clock):
    axis.begin_move(20.0)
    stage.state, stage.at_deg = "moving", 10.0
    clock.at_s += 1.0
    axis.poll()
    stage.state, stage.at_deg = "ready", 19.6
    assert axis.poll().moving
    clock.at_s += 1.1
    with pytest.raises(StageError, match=r"stands at 19\.600°"):
        axis.poll()


@pytest.mark.parametrize("astray_deg", [21.5, -1.5])
def test_a_move_that_leaves_its_way_is_stopped(axis, stage, astray_deg):
    axis.begin_move(20.0)
    stage.state, stage.at_deg = "moving", 20.0
    assert axis.poll() == Motion(20.0, moving=True)
    stage.at_deg = astray_deg
    with pytest.raises(StageError, match=r"20° from 0°.*stopped"):
        axis.poll()
    assert stage.sent[-1] == "ST"


def test_a_controller_that_was_reset_on_the_way_is_not_called_astray(axis, stage, monkeypatch):
    def lost():
        raise StageError("stage x has lost its angle: it was reset")

    axis.begin_move(20.0)
    stage.state, stage.at_deg = "moving", 100.0
    monkeypatch.setattr(stage, "position_deg", lost)
    with pytest.raises(StageError, match=r"was stopped: .*it was reset"):
        axis.poll()
    assert stage.sent[-1] == "ST"


def test_one_look_that_is_off_the_way_is_taken_for_a_damaged_one(axis, stage):
    axis.begin_move(20.0)
    stage.state, looks_deg = "moving", iter([84.0, 10.0])
    stage.glimpse_deg = lambda: next(looks_deg)
    assert axis.poll().moving
    assert "ST" not in stage.sent


def test_a_stage_that_counts_from_elsewhere_since_its_last_move_is_not_moved(axis, stage):
    axis.begin_move(20.0)
    stage.at_deg = 20.0
    assert not axis.poll().moving
    stage.at_deg = 0.0  # it was switched off and on
    with pytest.raises(StageError, match=r"20°.*0°.*without"):
        axis.begin_move(30.0)
    assert stage.sent == [("PA", 20.0)]


def test_a_stage_that_leaves_its_target_later_fails(axis, stage, clock):
    axis.begin_move(20.0)
    stage.at_deg = 20.0
    assert not axis.poll().moving
    clock.at_s += 3600
    stage.at_deg = 21.0
    axis.poll()
    clock.at_s += 1.1
    with pytest.raises(StageError, match=r"stands at 21\.000°"):
        axis.poll()


@pytest.mark.parametrize("state", ["disabled", "configuration"])
def test_a_stage_that_gives_up_fails_at_once(axis, stage, state):
    axis.begin_move(20.0)
    stage.state = state
    with pytest.raises(StageError, match=f"{state.upper()} during the move to 20°"):
        axis.poll()
    with pytest.raises(StageError, match=state.upper()):
        axis.needs_home()


def test_a_stage_that_says_moving_and_does_not_turn_is_stalled(axis, stage, clock):
    axis.begin_move(20.0)
    stage.state = "moving"
    for stage.at_deg in (1.0, 2.0):
        clock.at_s += 2.9
        axis.poll()
    clock.at_s += 2.9
    axis.poll()
    clock.at_s += 0.2
    with pytest.raises(StageError, match=r"stalled at 2\.000°.*MOVING"):
        axis.poll()


def test_a_move_takes_no_longer_than_twice_its_time_and_five_seconds(axis, stage, clock):
    axis.begin_move(20.0)  # 10 deg/s, 40 deg/s²: 2.25 s
    stage.state = "moving"
    began_s = clock.at_s
    with pytest.raises(StageError, match="took too long"):
        while True:
            clock.at_s += 0.1
            stage.at_deg += 0.1
            axis.poll()
    assert clock.at_s - began_s == pytest.approx(2 * 2.25 + 5, abs=0.15)


@given(distance=st.floats(1e-3, 360), velocity=st.floats(0.1, 100), acceleration=st.floats(0.1, 1000))
def test_the_travel_time_is_that_of_a_profile_integrated_step_by_step(distance, velocity, acceleration):
    """Oracle: the time after which the area under the symmetric trapezoid is the distance."""
    travel_s = travel_time_s(distance, velocity, acceleration)
    steps = 2000
    dt = travel_s / steps
    middles = [(k + 0.5) * dt for k in range(steps)]
    area = sum(min(velocity, acceleration * min(t, travel_s - t)) * dt for t in middles)
    assert area == pytest.approx(distance, rel=2e-3)


def test_homing_is_over_when_the_stage_is_ready(axis, stage):
    stage.state = "not_referenced"
    assert axis.needs_home()
    axis.begin_home()
    assert axis.poll().moving
    stage.state = "homing"
    assert axis.poll().moving
    stage.state = "ready"
    assert not axis.poll().moving
    assert not axis.needs_home()
    assert stage.sent == ["OR"]


def test_a_search_under_way_is_waited_for_and_not_begun_again(axis, stage):
    stage.state = "homing"
    assert axis.needs_home()
    axis.begin_home()
    assert axis.poll().moving
    assert stage.sent == []


def test_homing_that_ends_without_a_reference_fails(axis, stage, clock):
    stage.state = "not_referenced"
    axis.begin_home()
    axis.poll()
    clock.at_s += 1.1
    with pytest.raises(StageError, match=r"homing did not succeed.*NOT_REFERENCED"):
        axis.poll()


def test_homing_ends_after_two_minutes_at_most(axis, stage, clock):
    axis.begin_home()
    stage.state = "homing"
    clock.at_s += 119
    axis.poll()
    clock.at_s += 2
    with pytest.raises(StageError, match=r"homing (took too long|stalled)"):
        axis.poll()


def test_velocity_is_one_of_elevation_and_the_one_before_comes_back(stage):
    axis = Axis(stage, sign=-1, ratio=2.0)
    axis.identify()
    axis.set_velocity(3.0)
    axis.set_velocity(4.0)
    axis.close()
    assert stage.sent == [("VA", 6.0), ("VA", 8.0), ("VA", 10.0), "closed"]


def test_closing_never_raises_though_the_velocity_cannot_be_restored(axis, stage):
    axis.set_velocity(3.0)

    def refuse(velocity_dps):
        raise StageError("gone")

    stage.set_velocity = refuse
    axis.close()
    assert stage.sent[-1] == "closed"


def test_after_a_halt_the_axis_says_so(axis, stage):
    axis.begin_move(20.0)
    axis.halt()
    with pytest.raises(Halted):
        axis.poll()
    assert stage.sent[-1] == "ST"


def test_stop_is_sent_until_the_stage_stands_at_two_looks(axis, stage):
    stage.state = "moving"
    halt = stage.halt

    def halt_the_third_time():
        halt()
        if stage.sent.count("ST") == 3:
            stage.state = "ready"

    stage.halt = halt_the_third_time
    axis.confirm_stopped(timeout_s=60.0)
    assert stage.sent == ["ST"] * 4


def test_a_stage_that_does_not_stop_is_to_be_cut_from_power(axis, stage, clock):
    stage.state = "moving"
    halt = stage.halt

    def halt_as_time_goes_by():
        halt()
        clock.at_s += 0.6

    stage.halt = halt_as_time_goes_by
    with pytest.raises(StageError, match=r"MOVING.*cut its motor power"):
        axis.confirm_stopped(timeout_s=1.0)
    assert stage.sent == ["ST", "ST"]


def test_a_stage_that_wakes_late_and_stands_is_looked_at_once_more(axis, stage, clock):
    status, asleep_s = stage.status, [2.5]

    def status_once_awake():
        clock.at_s += asleep_s.pop() if asleep_s else 0.0
        return status()

    stage.status = status_once_awake
    axis.confirm_stopped(timeout_s=2.0)
    assert stage.sent == ["ST", "ST"]


def test_a_stage_that_says_it_stands_and_moves_on_is_to_be_cut_from_power(axis, stage, clock):
    stage.glimpse_deg = lambda: 1.0 * clock.at_s  # it creeps at 1°/s
    with pytest.raises(StageError, match=r"READY.*0\.05°.*cut its motor power"):
        axis.confirm_stopped(timeout_s=2.0)


def looks(stage, monkeypatch, *angles_deg):
    """Has each look at the stage find the next of these angles, the last of them ever after."""
    left = list(angles_deg)
    monkeypatch.setattr(stage, "glimpse_deg", lambda: left.pop(0) if len(left) > 1 else left[0])


def test_one_damaged_report_delays_the_end_of_a_stop_and_makes_no_motion(axis, stage, monkeypatch):
    looks(stage, monkeypatch, 12.5, 112.5, 12.5)
    axis.confirm_stopped(timeout_s=2.0)
    assert stage.sent == ["ST"] * 4


def test_reports_that_differ_to_the_last_are_shown_and_are_no_turn(axis, stage, clock, monkeypatch):
    monkeypatch.setattr(stage, "glimpse_deg", lambda: 112.5 if round(clock.at_s / 0.05) % 2 else 12.5)
    with pytest.raises(StageError, match=r"reports differ \(.*112.50°.*\)") as raised:
        axis.confirm_stopped(timeout_s=2.0)
    assert "turned by" not in str(raised.value)
    assert "e+" not in str(raised.value)


def test_a_turn_is_told_by_the_smaller_of_two_steps_since_one_report_may_be_damaged(
    axis, stage, clock, monkeypatch
):
    damaged_at_s = clock.at_s + 1.0
    monkeypatch.setattr(
        stage, "glimpse_deg", lambda: clock.at_s + 100.0 * (abs(clock.at_s - damaged_at_s) < 0.01)
    )
    with pytest.raises(StageError, match=r"turned by 0.05° meanwhile"):
        axis.confirm_stopped(timeout_s=0.99)


def test_a_look_that_is_not_answered_says_nothing_of_those_before_and_after_it(axis, stage, monkeypatch):
    status, left = stage.status, [False, True, True, False]

    def status_now_and_then():
        if left and left.pop(0):
            raise StageError("it does not answer")
        return status()

    monkeypatch.setattr(stage, "status", status_now_and_then)
    axis.confirm_stopped(timeout_s=2.0)
    assert stage.sent == ["ST"] * 4


def blocked(stage, times):
    """The stage's way to halt, where its port takes nothing so many times."""
    left = iter(range(times))

    def halt():
        if next(left, None) is not None:
            raise PortBlocked("port x took nothing for 0.5 s")
        stage.sent.append("ST")

    return halt


def test_a_stop_is_sent_again_where_its_port_did_not_take_it_in_time(axis, stage, monkeypatch):
    monkeypatch.setattr(stage, "halt", blocked(stage, times=3))
    axis.confirm_stopped(timeout_s=2.0)
    assert stage.sent == ["ST", "ST"]


def test_a_port_that_takes_no_stop_at_all_is_told_of_in_time(axis, stage, clock, monkeypatch):
    monkeypatch.setattr(stage, "halt", blocked(stage, times=1000))
    began_s = clock.at_s
    with pytest.raises(StageError, match=r"took nothing.*cut its motor power"):
        axis.confirm_stopped(timeout_s=2.0)
    assert clock.at_s - began_s == pytest.approx(2.0, abs=0.1)


def test_two_reports_of_a_stage_that_creeps_at_half_a_degree_a_second_do_not_agree():
    assert standstill.agree(20.0, 20.009)
    assert not standstill.agree(20.0, 20.0 + 0.5 * standstill.LOOKS_APART_S)


def test_an_axis_drives_a_controller_over_its_wire(controller):
    axis = Axis(Smc100.open(controller.path), zero_deg=5.0, sign=-1, ratio=1.0)
    axis.identify()
    assert axis.needs_home()
    axis.begin_home()
    assert axis.poll().moving
    controller.state = "32"
    assert not axis.poll().moving
    axis.begin_move(30.0)
    controller.state, controller.position = "28", "-10"
    assert axis.poll() == Motion(15.0, moving=True)
    controller.state, controller.position = "33", "-25"
    assert axis.poll() == Motion(30.0, moving=False)
    axis.close()
    assert [line for line in controller.received if re.match("1(OR|PA-)", line)] == ["1OR", "1PA-25"]


def test_a_move_the_controller_never_heard_of_fails(controller):
    clock = Clock()
    axis = Axis(Smc100.open(controller.path), clock=clock)
    controller.state = "33"
    axis.begin_move(30.0)
    axis.poll()
    clock.at_s += 1.1
    with pytest.raises(StageError, match=r"30°.*0\.000°"):
        axis.poll()
    axis.close()
