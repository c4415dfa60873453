"""What unmodified GRBL 1.1h was recorded to do (../shared/wire), and what the driver makes of it."""

from __future__ import annotations

import re
from collections import Counter

import pytest
from grbl_script import BANNER, GO, IDLE, SETTINGS, Script
from stage_ports import InProcessPort, homed, until_it_stands
from wire_recordings import Event, recording, recordings

from calrig.instruments.errors import StageError
from calrig.instruments.stages.grbl import DEVICE
from calrig.instruments.stages.grbl.driver import Count, Grbl
from calrig.instruments.stages.grbl.link import GrblLink
from calrig.instruments.stages.grbl.protocol import parse_report
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


GRBL = recordings("grbl11h-*")
BEFORE_1_1 = recordings("grbl09j-*")
GARBLED = {"grbl11h-wrong-baud": 1}
"""Lines sent at another baud rate."""
STATES = {
    **dict.fromkeys(("Run", "Jog", "Hold:1", "Door:2"), "moving"),
    **dict.fromkeys(("Hold:0", "Door:0", "Door:1", "Sleep"), "disabled"),
    **{"Idle": "ready", "Alarm": "not_referenced", "Check": "configuration", "Home": "homing"},
}


def scripted(name: str) -> tuple[Script, InProcessPort]:
    controller = Script()
    port = InProcessPort(controller, name)
    controller.now_s = port.clock.now_s
    return controller, port


def said_in(rows: list[Event]) -> list[str]:
    return [row.text for row in rows if row.says("")]


def taken_in(name: str) -> tuple[GrblLink, Count, Counter[str]]:
    """What the link and the count are after every message of a recording."""
    faults: Counter[str] = Counter()
    port, count = InProcessPort(Script(), name), Count(0, name)
    link = GrblLink(port, faults)
    for text in said_in(recording(name)):
        port.push(text.encode("latin-1"))
        link.catch_up()
        if report := parse_report(text.strip()):
            count.hear_offset(report)
            count.degrees(report)
    return link, count, faults


@pytest.mark.parametrize("name", GRBL)
def test_every_message_is_understood(name):
    link, count, faults = taken_in(name)
    said = [text.strip() for text in said_in(recording(name))]
    assert (faults["unparsed"], faults["echo"]) == (GARBLED.get(name, 0), 0)
    banners = [k for k, text in enumerate(said) if text.startswith("Grbl ")]
    assert link.resets == len(banners)
    assert link.firmware == ("Grbl 1.1h" if banners else None)
    alarms = [(k, int(text[6:])) for k, text in enumerate(said) if text.startswith("ALARM:")]
    assert link.alarm == (alarms[-1][1] if alarms else None)
    assert link.locked == (bool(alarms) and alarms[-1][1] in (1, 2) and max(banners) < alarms[-1][0])
    reports = [text for text in said if text.startswith("<")]
    if reports:
        offsets = [float(found[1]) for text in reports if (found := re.search(r"WCO:([-.\d]+)", text))]
        frame, first = re.search(r"([MW])Pos:([-.\d]+)", reports[-1]).groups()
        if frame == "W" or offsets[-2:-1] == offsets[-1:]:
            here_deg = float(first) - (offsets[-1] if frame == "M" and offsets else 0)
            assert count.shown_deg == pytest.approx(here_deg, abs=1e-9)


@pytest.mark.parametrize("name", BEFORE_1_1)
def test_an_older_firmware_is_named_and_not_spoken(name):
    link, _, _ = taken_in(name)
    assert (link.before_1_1, link.firmware, link.alarm) == (True, "Grbl 0.9j", None)


@pytest.mark.parametrize("name", GRBL)
def test_every_report_is_a_state(name):
    controller = Script()
    stage = homed(Grbl(InProcessPort(controller, name)))
    reports = {text.strip() for text in said_in(recording(name)) if text.startswith("<")}
    for text in sorted({re.sub(r"\|WCO:[^|>]*", "", report) for report in reports}):
        controller.report = text
        state = re.match(r"<(\w+(?::\d)?)", text)[1]
        assert stage.status().state == STATES[state], text
        stage.glimpse_deg()
    assert set(stage.faults) <= {"zero_not_homed"}


def conversations(way: str, text: str) -> list:
    """Each recorded line with this text, as (recording, row)."""
    found = [
        pytest.param(name, k, id=f"{name}-{k}")
        for name in GRBL
        if isinstance(name, str)
        for k, row in enumerate(recording(name))
        if (row.way, row.text) == (way, text)
    ]
    return found or [pytest.param("", 0, marks=pytest.mark.skip("no recorded conversations here"))]


def played(rows: list[Event], since_s: float) -> list[tuple[float, str]]:
    return [(row.t_s - since_s, row.text) for row in rows if row.says("")]


def reset_after(rows: list[Event]) -> tuple[Event, list[tuple[float, str]], str]:
    """The first reset that was taken, what it set off, and the next report."""
    told = next((k for k, row in enumerate(rows) if row.says("[MSG:Reset to continue")), 0)
    at = next(k for k, row in enumerate(rows) if k >= told and row.way == "to" and "\x18" in row.text)
    rest = rows[at + 1 :]
    report = next(row.text.strip() for row in rest if row.says("<"))
    within = [row for row in rest if row.t_s < rows[at].t_s + 0.25]
    return rows[at], played(within, rows[at].t_s), report


@pytest.mark.parametrize(("name", "row"), conversations("to", "$H\n"))
def test_a_homing_succeeds_or_fails_as_recorded(name, row):
    rows = recording(name)[row:]
    answer = next(one for one in rows if one.says("ok", "error:"))
    within = [one for one in rows if one.t_s < answer.t_s + 0.06]
    play = [one for one in played(within, rows[0].t_s) if not one[1].startswith(("<", "[GC"))]
    controller, port = scripted(name)
    stage = Grbl(port)
    stage.identify()
    controller.plays["$H"] = play
    if answer.text.startswith("error:"):
        with pytest.raises(StageError, match=r"refused \$H"):
            stage.home()
        return
    up_s, resets = port.clock.now_s() + play[-1][0], stage._link.resets
    receive = controller.receive

    def silent_while_it_homes(data):
        controller.silent = data == b"?" and port.clock.now_s() < up_s
        return receive(data)

    stage.home()
    controller.receive = silent_while_it_homes
    controller.report = next(one.text.strip() for one in rows if one.t_s > answer.t_s and one.says("<"))
    failed = any(text.startswith("ALARM") for _, text in play)
    assert until_it_stands(stage) == ("not_referenced" if failed else "ready")
    assert stage._link.resets - resets == sum(text.startswith("Grbl") for _, text in play)
    if not failed:
        assert stage.position_deg() == parse_report(controller.report).position[0]


@pytest.mark.parametrize(("name", "row"), conversations("from", "ALARM:2\r\n"))
def test_a_soft_limit_keeps_the_angle_as_recorded(name, row):
    rows = recording(name)[row:]
    controller, port = scripted(name)
    _, after, report = reset_after(rows)
    controller.report = report.replace("Alarm", "Idle")
    stage = homed(Grbl(port))
    alarm = [one for one in rows if one.says("ALARM:2", "[MSG:Reset")][:2]
    controller.plays = {f"{GO} X500": played(alarm, alarm[0].t_s), "\x18": after}
    with pytest.raises(StageError, match="ALARM:2"):
        stage.move(500)
    assert (controller.resets, controller.lines[-2:]) == (1, ["$X", "$$"])
    assert stage.position_deg() == stage._count.shown_deg


@pytest.mark.parametrize(("name", "row"), conversations("from", "ALARM:1\r\n"))
def test_a_hard_limit_costs_the_angle_as_recorded(name, row):
    rows = recording(name)[row:]
    if not any(one.way == "to" and "\x18" in one.text for one in rows):
        pytest.skip("the recording ends before a reset")
    controller, port = scripted(name)
    stage = homed(Grbl(port))
    _, after, report = reset_after(rows)
    alarm = [one for one in rows if one.says("ALARM:1", "[MSG:Reset")][:2]
    controller.plays = {"hit": played(alarm, alarm[0].t_s), "\x18": after}
    controller._plays("hit")
    controller.report = report
    status = stage.status()
    assert (status.state, controller.resets) == ("not_referenced", 1)
    assert "ALARM:1" in status.words
    with pytest.raises(StageError, match="lost its angle: ALARM:1"):
        stage.position_deg()
