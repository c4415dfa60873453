"""What unmodified GRBL 1.1h was recorded to do, and what the driver makes of it."""

from __future__ import annotations

import pytest
from grbl_script import BANNER, GO, IDLE, SETTINGS, Script
from stage_ports import InProcessPort, homed, until_it_stands

from calrig.instruments.errors import StageError
from calrig.instruments.stages.grbl import DEVICE
from calrig.instruments.stages.grbl.driver import Grbl
from calrig.instruments.stages.grbl.settings import ControllerSettings
from calrig.instruments.standstill import confirm_standstill

WELCOME = "\r\nGrbl 1.1h ['$' for help]\r\n"
UNLOCK = "[MSG:'$H'|'$X' to unlock]\r\n"
REFUSED = [(0.004, "ALARM:2\r\n"), (0.505, "[MSG:Reset to continue]\r\n")]
RESET_AFTER_REFUSAL = [(0.004, "ok\r\n"), (0.028, WELCOME), (0.032, UNLOCK)]
HIT = [(0.0, "ALARM:1\r\n"), (0.502, "[MSG:Reset to continue]\r\n")]


def stage_on(controller: Script, port: InProcessPort | None = None) -> Grbl:
    port = port or InProcessPort(controller)
    controller.now_s = port.clock.now_s
    return Grbl(port)


@pytest.fixture
def controller():
    return Script()


@pytest.fixture
def stage(controller):
    return homed(stage_on(controller))


@pytest.mark.parametrize("told", [REFUSED, REFUSED[:1]], ids=["told", "message lost"])
def test_after_a_soft_limit_the_reset_waits_until_it_is_taken_and_the_angle_is_kept(controller, stage, told):
    controller.plays = {f"{GO} X200": told, "\x18": RESET_AFTER_REFUSAL}
    with pytest.raises(StageError, match="ALARM:2, soft limit"):
        stage.move(200)
    assert (controller.resets, controller.lines[-2:]) == (1, ["$X", "$$"])
    assert stage.position_deg() == 0
    stage.move(10)


def test_the_ok_of_a_refused_line_answers_nothing_after_the_reset(controller, stage):
    controller.plays = {f"{GO} X200": REFUSED, "\x18": RESET_AFTER_REFUSAL}
    controller.answers["$X"] = b"error:9\r\n"
    with pytest.raises(StageError, match=r"refused \$X"):
        stage.move(200)


def test_a_hard_limit_is_told_once_and_the_stage_is_seen_to_stand(controller, stage):
    stage.move(60)
    controller.report = "<Run|MPos:20.000,0.000,0.000|FS:1200,0>"
    assert stage.status().state == "moving"
    controller.plays = {"hit": HIT, "\x18": [(0.026, WELCOME), (0.028, "[MSG:Check Limits]\r\n" + UNLOCK)]}
    controller._plays("hit")
    controller.report = "<Alarm|MPos:24.044,0.000,0.000|FS:0,0|Pn:X>"
    words = stage.status().words
    assert words.count("ALARM:1") == 1
    assert "GRBL has stopped the motor by itself" in words
    with pytest.raises(StageError, match=r"ALARM:1.*start again") as told:
        stage.position_deg()
    assert str(told.value).count("limit switch") == 1
    assert "$X" not in controller.lines
    confirm_standstill(stage, stage._link.lines._port.clock, 2.0)


FAILED_HOMING = [(7.9, "ALARM:9\r\n"), (8.4, "ok\r\n"), (8.43, WELCOME), (8.44, UNLOCK)]


@pytest.mark.parametrize("told", [FAILED_HOMING, FAILED_HOMING[1:2]], ids=["told", "only its ok has come"])
def test_the_ok_of_a_failed_homing_is_no_success(controller, told):
    stage = stage_on(controller)
    stage.identify()
    controller.plays["$H"] = told
    controller.report = "<Alarm|MPos:0.000,0.000,-300.000|FS:0,0>"
    began_s, receive = controller.now_s(), controller.receive

    def silent_while_it_homes(data):
        controller.silent = data == b"?" and controller.now_s() < began_s + 8.45
        return receive(data)

    stage.home()
    controller.receive = silent_while_it_homes
    assert until_it_stands(stage) == "not_referenced"
    assert controller.now_s() > began_s + 7
    assert ("ALARM:9" if told is FAILED_HOMING else "homing failed") in stage.status().words
    with pytest.raises(StageError, match="takes no move"):
        stage.move(10)


def test_a_reset_between_check_and_move_is_refused_by_the_controller_and_named(controller, stage):
    stage.move(10)

    def reset_unseen(data, receive=controller.receive):
        if data.startswith(f"{GO} X20".encode()):
            controller.receive = receive
            controller.modal = Script().modal
        return receive(data)

    controller.receive = reset_unseen
    with pytest.raises(StageError, match=r"lost its angle.*reset"):
        stage.move(20)
    assert "F0 S0" in controller.modal, "the move was refused"


def test_a_move_names_no_feed_rate_so_that_a_controller_that_was_reset_refuses_it(controller, stage):
    stage.set_velocity(5)
    stage.move(10)
    assert controller.lines[-2] == f"{GO} X10"
    assert " F300 S211" in controller.modal


def test_an_alarm_in_place_of_the_modal_state_is_named(controller, stage):
    stage.move(0)
    controller.plays = {"$G": HIT, "\x18": [(0.026, WELCOME), (0.028, UNLOCK)]}
    with pytest.raises(StageError, match="lost its angle: ALARM:1"):
        stage.position_deg()


@pytest.mark.parametrize("line", ["G0 X5", "G92 X5", "G4 P0", "F100 T211", "M3 S500 T211"])
def test_a_line_of_another_programs_costs_the_angle(controller, stage, line):
    stage.move(10)
    controller.receive(f"{line}\n".encode())
    with pytest.raises(StageError, match="another program sends it G-code"):
        stage.position_deg()


def test_what_leaves_the_marks_as_they_are_costs_nothing(controller, stage):
    stage.move(0)
    for line in ("", "$G", "$#"):
        controller.receive(f"{line}\n".encode())
    assert stage.position_deg() == 0


def test_a_build_without_spindle_speed_is_known_by_its_feed_rate(controller):
    controller.modal = controller.modal.removesuffix(" S0")
    stage = homed(stage_on(controller))
    stage.move(0)
    assert stage.position_deg() == 0
    controller.modal = Script().modal.removesuffix(" S0")
    with pytest.raises(StageError, match="it was reset"):
        stage.position_deg()


def test_a_reset_before_the_first_move_costs_an_angle_that_was_stated(controller):
    controller.settings[22] = "0"
    port = InProcessPort(controller)
    stage = stage_on(controller, port)
    assert stage.position_deg() == 0
    port.push(BANNER)
    with pytest.raises(StageError, match=r"lost its angle.*--stage-at"):
        stage.position_deg()


@pytest.mark.parametrize(
    "report",
    [
        "<Idle|MPos:-195.000,-198.000,-198.000|FS:0,0|WCO:-198.000,0.000,0.000>",
        "<Idle|WPos:3.000,-198.000,-198.000|Bf:15,128|FS:0,0|WCO:-198.000,0.000,0.000>",
    ],
)
def test_machine_coordinates_are_negative_after_homing_and_limits_are_in_work_coordinates(controller, report):
    controller.settings[130] = "200.000"
    controller.report = report
    stage = stage_on(controller)
    assert stage.identify().limits_deg == (-2.0, 398.0)
    assert stage.position_deg() == 3.0


def test_a_stage_of_coarse_steps_is_still_watched_for_jumps(controller):
    controller.settings[100] = "8.889"
    stage = homed(stage_on(controller))
    controller.report = "<Idle|MPos:10.012,0.000,0.000|FS:0,0>"
    stage.move(10.05)
    assert stage.position_deg() == 10.012
    controller.report = IDLE
    with pytest.raises(StageError, match=r"jumped from 10\.012° to 0°"):
        stage.position_deg()


@pytest.mark.parametrize(
    ("changed", "setting"),
    [
        ({1: 25.0}, "$1=255"),
        ({20: 0.0}, "$20=1"),
        ({22: 0.0}, "$22=1"),
        ({100: 250.0, 110: 500.0, 120: 10.0}, "$100"),
        ({100: 8.889}, "One step is 0.112°"),
        ({100: 1600.0, 110: 3600.0}, "96 kHz"),
    ],
)
def test_a_setting_that_puts_poses_in_doubt_is_a_warning_with_what_to_set(changed, setting):
    usual = {number: float(value) for number, value in SETTINGS.items()}
    assert ControllerSettings(usual, 0).warnings == ()
    [warning] = ControllerSettings({**usual, **changed}, 0).warnings
    assert setting in warning


@pytest.mark.parametrize(("number", "value"), [(13, "1"), (100, "0.000"), (110, "0.000"), (120, "0.000")])
def test_a_setting_that_makes_poses_impossible_is_refused_with_what_to_set(controller, number, value):
    controller.settings[number] = value
    with pytest.raises(StageError, match=rf"set \${number}"):
        stage_on(controller).identify()


def test_a_scan_says_what_is_wrong_with_the_settings(controller):
    controller.settings[1] = "25"
    heard = controller.receive(b"?" + DEVICE.version_query).decode().split("\r\n")
    words = DEVICE.identity([line for line in heard if DEVICE.matches(line)]).words
    assert words.startswith("Grbl 1.1h.20190825, in Idle. $1=25 ")


def test_it_homes_after_an_alarm_that_locked_it(controller, stage):
    controller.plays = {"hit": HIT}
    controller._plays("hit")
    assert stage.status().state == "not_referenced"
    assert homed(stage).position_deg() == 0
