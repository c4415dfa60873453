from __future__ import annotations

import pytest
from grbl_script import BANNER, GO, IDLE, Script
from stage_ports import InProcessPort, homed, until_it_stands

from calrig.instruments.errors import Halted, StageError
from calrig.instruments.stages.grbl.driver import Grbl
from calrig.instruments.stages.grbl.protocol import ALARMS, ERRORS, parse_report
from calrig.instruments.stages.grbl.settings import ACCELERATION, RATE, STEPS, ControllerSettings
from calrig.instruments.types import StageIdentity


@pytest.fixture
def controller():
    return Script()


@pytest.fixture
def port(controller, request):
    return InProcessPort(controller, request.node.name)


@pytest.fixture
def stage(port):
    return Grbl(port)


@pytest.fixture
def referenced(controller, stage):
    """A stage that has been homed and stands at 0°."""
    return homed(stage)


def test_it_says_what_its_settings_allow(controller, port, stage):
    port.push(BANNER)
    assert stage.identify() == StageIdentity(
        "grbl", "Grbl 1.1h", (-180.0, 180.0), 20.0, 80.0, homes_each_time=True
    )


def test_without_soft_limits_it_has_no_limits_of_its_own(controller, stage):
    controller.settings[20] = "0"
    assert stage.identify().limits_deg is None


def test_another_axis_has_its_own_letter_settings_and_place(controller, port):
    controller.report = "<Idle|MPos:1.000,-7.250,3.000|FS:0,0>"
    stage = Grbl(port, axis=2)
    assert stage.identify().velocity_dps == 10.0
    assert stage.position_deg() == -7.25
    homed(stage).move(5)
    assert f"{GO} Y5" in controller.lines


@pytest.mark.parametrize("state", ["Alarm", "Check", "Sleep", "Hold:0", "Door:0", "Run"])
def test_a_controller_that_is_not_idle_is_sent_no_move(controller, referenced, state):
    """In Alarm, whose message may have been lost, GRBL 1.1 locks G-code out (error:9)."""
    controller.report = f"<{state}|MPos:0.000,0.000,0.000|FS:0,0>"
    with pytest.raises(StageError, match=state.partition(":")[0].upper()):
        referenced.move(5)
    assert not [line for line in controller.lines if "G1" in line]


def test_opening_and_identifying_moves_nothing_and_unlocks_nothing(controller, port, stage):
    stage.identify()
    stage.status()
    stage.position_deg()
    assert set(controller.lines) == {"$$", "$I"}
    assert controller.resets == 0


@pytest.mark.parametrize(
    ("report", "state", "words"),
    [
        ("<Run|MPos:1.000,0.000,0.000|FS:500,0>", "moving", "RUN"),
        ("<Jog|MPos:1.000,0.000,0.000|FS:500,0>", "moving", "JOG"),
        ("<Hold:1|MPos:1.000,0.000,0.000|FS:500,0>", "moving", "HOLD"),
        ("<Hold:0|MPos:1.000,0.000,0.000|FS:0,0>", "disabled", "HOLD"),
        ("<Door:0|MPos:1.000,0.000,0.000|FS:0,0>", "disabled", "DOOR"),
        ("<Sleep|MPos:0.000,0.000,0.000|FS:0,0>", "disabled", "SLEEP"),
        ("<Check|MPos:0.000,0.000,0.000|FS:0,0>", "configuration", "CHECK"),
        ("<Home|MPos:0.000,0.000,0.000|FS:0,0>", "homing", "HOME"),
        ("<Alarm|MPos:0.000,0.000,0.000|FS:0,0>", "not_referenced", "ALARM"),
        (IDLE, "ready", "IDLE"),
    ],
)
def test_every_state_is_said_in_words(controller, referenced, report, state, words):
    controller.report = report
    status = referenced.status()
    assert status.state == state
    assert status.words.startswith(words)


@pytest.mark.parametrize(
    ("report", "degrees"),
    [
        ("<Idle|MPos:12.345,0.000,0.000|FS:0,0>", 12.345),
        ("<Idle|MPos:-0.005,0.000,0.000|Bf:15,128|FS:0,0|Ov:100,100,100>", -0.005),
        ("<Idle|WPos:7.500,0.000,0.000|FS:0,0|WCO:90.000,0.000,0.000>", 7.5),
        ("<Idle|MPos:7.500,0.000,0.000|FS:0,0|WCO:90.000,0.000,0.000>", -82.5),
        ("<Idle|MPos:7.500,0.000,0.000,1.000|Pn:XYZ|FS:0,0>", 7.5),
    ],
)
def test_the_place_is_read_in_work_coordinates(controller, stage, report, degrees):
    controller.report = report
    stage.identify()
    assert stage.position_deg() == degrees


@pytest.mark.parametrize(
    ("number", "word"),
    [
        (1, "limit switch"),
        (2, "soft limit"),
        (3, "reset"),
        (4, "probe"),
        (5, "probe"),
        (6, "homing"),
        (7, "door"),
        (8, "pulling off"),
        (9, "no limit switch"),
    ],
)
def test_an_alarm_has_the_words_of_its_number(number, word):
    """gnea/grbl, doc/csv/alarm_codes_en_US.csv."""
    assert word in ALARMS[number]


def test_an_offset_that_came_once_only_is_taken_for_damage(controller, referenced):
    """A report carries WCO now and then and has no checksum: one digit may have been damaged."""
    for offset in ("0.000", "0.000", "90.000", "0.000"):
        controller.report = f"<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:{offset},0.000,0.000>"
        assert referenced.glimpse_deg() == 0.0
    assert referenced.status().state == "ready"


@pytest.mark.parametrize(
    "damaged",
    [
        "Idle|MPos:1.000,0.000,0.000|FS:0,0>",
        "<Idle|MPos:1.000,0.000,0.000|FS:0,0",
        "<Idle|MPos:1.000,0.000<Idle|MPos:1.000,0.000,0.000|FS:0,0>",
        "<Idle|MPos:1.0.00,0.000,0.000|FS:0,0>",
        "<Idel|MPos:1.000,0.000,0.000|FS:0,0>",
        "<Idle|MPos:1.000,0.000,0.000|WCO:1.0,|FS:0,0>",
        "<Idle>",
    ],
)
def test_a_damaged_report_is_no_report(damaged):
    assert parse_report(damaged) is None


def test_a_move_goes_at_full_speed_or_at_the_velocity_set(controller, referenced):
    referenced.move(-59.5)
    referenced.set_velocity(12.5)
    referenced.move(10)
    assert [line for line in controller.lines if line[0] == "G"] == [
        "G21 G90 G94 T211 M5 S211 F1200",
        f"{GO} X-59.5",
        "G21 G90 G94 T211 F750",
        f"{GO} X10",
    ]
    with pytest.raises(StageError, match=r"20°/s at most \(\$110\)"):
        referenced.set_velocity(21)


def test_a_move_that_was_damaged_on_its_way_is_sent_again(controller, referenced):
    controller.answers[f"{GO} X10"] = [b"error:2\r\n"]
    referenced.move(10)
    assert controller.lines.count(f"{GO} X10") == 2
    assert referenced.faults["resent"] == 1


@pytest.mark.parametrize("number", sorted(ERRORS))
def test_a_refused_move_is_refused_in_words(controller, referenced, number):
    controller.answers[f"{GO} X10"] = b"error:%d\r\n" % number
    if number == 8:
        return  # never a G-code's answer
    with pytest.raises(StageError, match=rf"refused G1 X10: .*\(error:{number}\)"):
        referenced.move(10)


@pytest.mark.parametrize("number", sorted(set(ALARMS) - {2}))
def test_an_alarm_costs_the_angle_until_it_is_homed_again(controller, port, referenced, number):
    port.push(b"ALARM:%d\r\n" % number)
    controller.report = "<Alarm|MPos:3.000,0.000,0.000|FS:0,0>"
    status = referenced.status()
    assert status.state == "not_referenced"
    assert f"ALARM:{number}, {ALARMS[number]}" in status.words
    with pytest.raises(StageError, match=f"ALARM:{number}"):
        referenced.move(10)
    with pytest.raises(StageError, match=f"has lost its angle: ALARM:{number}"):
        referenced.position_deg()
    assert "$X" not in controller.lines
    referenced.home()
    controller.report = IDLE
    assert until_it_stands(referenced) == "ready"
    assert referenced.position_deg() == 0


def test_a_soft_limit_alarm_keeps_the_angle_and_is_unlocked(controller, referenced):
    controller.answers[f"{GO} X200"] = b"ALARM:2\r\n[MSG:Reset to continue]\r\n"
    with pytest.raises(StageError, match=r"G1 X200.*ALARM:2"):
        referenced.move(200)
    assert controller.resets == 1
    assert controller.lines[-2:] == ["$X", "$$"]
    assert referenced.status().state == "ready"
    referenced.move(10)


def test_a_count_that_changed_in_a_soft_limit_alarm_is_not_unlocked(controller, referenced):
    def reset_and_lose(data, receive=controller.receive):
        if data == b"\x18":
            controller.report = "<Alarm|MPos:1.000,0.000,0.000|FS:0,0>"
        return receive(data)

    controller.answers[f"{GO} X200"] = b"ALARM:2\r\n"
    controller.receive = reset_and_lose
    with pytest.raises(StageError, match="soft limit"):
        referenced.move(200)
    assert "$X" not in controller.lines
    with pytest.raises(StageError, match=r"takes no move: .*count changed"):
        referenced.move(10)


def test_a_reset_after_a_motion_costs_the_angle(port, referenced):
    port.push(BANNER)
    assert "its count with it" in referenced.status().words
    with pytest.raises(StageError, match="lost its angle"):
        referenced.position_deg()


def test_without_homing_it_counts_from_where_it_was_switched_on_and_says_so(controller, port):
    controller.settings[22] = "0"
    stage = Grbl(port)
    stage.identify()
    assert stage.status().words == "IDLE, counting from where it was switched on"
    assert stage.faults["zero_not_homed"] == 1
    assert not stage.identify().homes
    stage.move(5)


def test_an_echo_is_counted_and_is_no_answer(controller, referenced):
    controller.answers[f"{GO} X10"] = [f"{GO} X10\r\nok\r\n".encode()]
    referenced.move(10)
    assert referenced.faults["echo"] == 1


def test_reports_in_inches_are_refused(controller, stage):
    controller.settings[13] = "1"
    with pytest.raises(StageError, match=r"set \$13=0"):
        stage.identify()


def test_a_setting_misread_once_is_read_again(controller, stage):
    whole = Script()._answer("$$")
    controller.answers["$$"] = [whole.replace(b"$110=1200", b"$110=7200"), whole, whole]
    assert stage.identify().velocity_dps == 20.0


def test_a_listing_cut_alike_twice_is_not_believed(controller, stage):
    whole = Script()._answer("$$")
    controller.answers["$$"] = [whole[whole.index(b"$100") :]] * 2
    assert stage.status().state == "not_referenced"  # it has homing, which the lost half says


def test_a_refused_homing_is_said_at_once(controller, stage):
    controller.answers["$H"] = b"error:5\r\n"
    with pytest.raises(StageError, match=r"\$H.*\$22"):
        stage.home()
    assert controller.lines.count("$H") == 1


def test_an_ok_of_another_command_is_not_taken_for_a_moves_own(controller, port, referenced):
    controller.answers[f"{GO} X10"] = b"ok\r\nerror:9\r\n"  # the first was late, and is another's
    with pytest.raises(StageError, match="error:9"):
        referenced.move(10)
    assert referenced.faults["late_reply"] == 1


def test_a_move_whose_ok_is_lost_is_sent_again_to_the_same_place(controller, referenced):
    controller.answers[f"{GO} X10"] = [b"o\xfe\r\n", b"ok\r\n"]
    referenced.move(10)
    assert controller.lines.count(f"{GO} X10") == 2


def test_while_it_runs_the_refused_listing_is_no_answer_to_the_move(controller, referenced):
    controller.answers["$$"] = b"error:8\r\n"
    referenced.move(10)


def test_a_silent_controller_is_reset_once_and_then_given_up_in_words(controller, port, stage):
    controller.silent = True
    with pytest.raises(StageError, match=rf"on {port.name} does not answer .*check power"):
        stage.status()
    assert port.sent.count(b"\x18") == 1
    assert port.clock.now_s() < 6.0, "whoever presses Stop waits for it"


def test_a_report_whose_place_is_no_number_is_quoted(controller, stage):
    stage.status()
    controller.report = "<Idle|MPos:nan,0.000,0.000|FS:0,0>"
    with pytest.raises(StageError, match=r"answers \? with '<Idle\|MPos:nan.*which cannot be read"):
        stage.status()


def test_a_controller_behind_a_boot_loader_is_waited_for(controller, port, stage):
    controller.silent = True
    receive = controller.receive

    def receive_once_it_runs(data):
        controller.silent = port.clock.now_s() < 2.5
        return receive(data)

    controller.receive = receive_once_it_runs
    assert stage.status().state == "not_referenced"
    assert controller.resets == 0


def test_a_stop_sends_hold_and_jog_cancel_and_no_motion_after_it(controller, port, referenced):
    before = len(port.sent)
    referenced.halt()
    assert port.sent[before:] == b"!\x85"
    with pytest.raises(Halted, match="G1 X10 was not sent"):
        referenced.move(10)
    with pytest.raises(Halted, match=r"\$H was not sent"):
        referenced.home()
    assert b"~" not in port.sent


def test_what_a_stop_left_of_a_move_is_thrown_away(controller, port, referenced):
    referenced.halt()
    controller.report = "<Hold:0|MPos:5.000,0.000,0.000|FS:0,0>"
    referenced.close()
    assert controller.resets == 1
    assert port.closed


def test_homing_is_stopped_by_a_reset(port, stage):
    stage.home()
    stage._homing = True
    stage.halt()
    assert port.sent.endswith(b"!\x85\x18")


@pytest.mark.parametrize(("rate_per_min", "is_too_fast"), [(17_900.0, False), (18_100.0, True)])
def test_more_than_30_khz_of_steps_are_in_doubt(rate_per_min, is_too_fast):
    """100 steps a degree: 30 kHz, which GRBL's README gives as its most, are 18,000 degrees a minute."""
    settings = ControllerSettings({STEPS: 100.0, RATE: rate_per_min, ACCELERATION: 50.0}, 0)
    assert any("kHz" in warning for warning in settings.warnings) is is_too_fast
