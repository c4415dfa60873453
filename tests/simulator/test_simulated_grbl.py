"""The simulated GRBL against every recorded conversation with the real one, and each fact alone."""

from __future__ import annotations

import re

import numpy as np
import pytest
from recorded_wires import AT_WRONG_BAUD_S, Recording, Replay
from wire_recordings import recordings

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import stage_of

POLL_S = 0.001
ANSWERED_S = 0.05
START = "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]"
BANNER = ["", "Grbl 1.1h ['$' for help]"]
LOCKED = [*BANNER, "[MSG:'$H'|'$X' to unlock]"]


class Wire:
    """A controller, the host's end of its wire, and the hand on their clock."""

    def __init__(self, mechanics: dict | None = None, **stage) -> None:
        options = {"driver": "grbl", "velocity_dps": 20.0, "acceleration_dps2": 100.0, **stage}
        settings = SimulatorSettings.from_options(
            {"preset": "ideal", "stage": options, "mechanics": mechanics or {}}
        )
        self.now_s = 5.0
        self.bench = Bench(settings)
        self.device = stage_of("grbl")(settings.stage, self.bench, lambda: self.now_s)

    def tell(self, data: str | bytes, for_s: float = ANSWERED_S) -> list[str]:
        """Sends bytes and returns the lines that came within a time."""
        said = self.device.receive(data.encode("latin-1") if isinstance(data, str) else data)
        end_s = self.now_s + for_s
        while self.now_s < end_s:
            self.now_s += POLL_S
            said += self.device.emit()
        return said.decode("latin-1").split("\r\n")[:-1]

    def ask(self, line: str, for_s: float = ANSWERED_S) -> list[str]:
        return self.tell(f"{line}\n", for_s)

    def report(self) -> str:
        (report,) = self.tell("?")
        return report

    def table_deg(self) -> float:
        return float(self.bench.mechanics.table(np.array([self.now_s])).angle_deg[0])


def unhomed(**options) -> Wire:
    wire = Wire(homing=False, **options)
    wire.tell("")
    return wire


def homed(**options) -> Wire:
    wire = Wire(**options)
    wire.tell("")
    assert wire.ask("$H", for_s=15.0) == ["ok"]
    return wire


def test_it_is_locked_until_it_is_homed_or_unlocked():
    wire = Wire()
    assert wire.tell("") == LOCKED
    assert wire.ask("G0 X10") == ["error:9"]
    assert wire.ask("$J=G91 X1 F100") == ["error:8"]
    assert wire.ask("$X") == ["[MSG:Caution: Unlocked]", "ok"]
    assert wire.report().startswith("<Idle|")


def test_the_tool_number_lasts_until_the_next_line_without_one_and_the_spindle_speed_until_a_reset():
    wire = unhomed()
    wire.ask("T211")
    wire.ask("S211")
    assert wire.ask("$G")[0].endswith("T0 F0 S211]")
    wire.ask("T211 G0 X1")
    wire.tell("\n(x)\nG55 Q1\n")  # an empty line, a comment, a line that is refused
    assert wire.ask("$G")[0].endswith("T211 F0 S211]")
    wire.ask("G4 P0", for_s=0.5)
    assert wire.ask("$G")[0].endswith("T0 F0 S211]")
    assert wire.tell("\x18") == BANNER
    assert wire.ask("$G") == [START, "ok"]


@pytest.mark.parametrize("word", ["F211", "G18", "M8", "G55", "G20", "G91", "G93", "G43.1 Z1.5", "G92 X5"])
def test_a_modal_word_lasts_until_a_reset_and_what_the_eeprom_keeps_outlasts_it(word):
    wire = unhomed()
    wire.ask("G10 L20 P1 X7")
    before = wire.ask("$G") + wire.ask("$#")
    wire.ask(word)
    changed = wire.ask("$G") + wire.ask("$#")
    assert changed != before
    wire.ask("$J=G91 X1 F600", for_s=4.0)
    assert wire.ask("$G") + wire.ask("$#") == changed
    wire.tell("\x18")
    assert wire.ask("$G") + wire.ask("$#") == before
    assert "WCO:-7.000" in wire.report()


def test_a_reset_keeps_the_count_and_the_reset_line_begins_it_at_0():
    wire = unhomed(boot_s=1.5)
    wire.ask("G0 X12", for_s=2.0)
    wire.tell("\x18")
    assert "MPos:12.000" in wire.report()
    wire.device.reset()
    assert wire.tell("?", for_s=1.4) == []
    assert wire.tell("", for_s=0.2)[: len(BANNER)] == BANNER
    assert "MPos:0.000" in wire.report()


def test_a_reset_on_the_way_is_an_alarm_half_a_second_before_the_banner():
    wire = unhomed()
    wire.ask("G0 X40", for_s=0.6)
    assert wire.tell("\x18", for_s=0.5) == ["ALARM:3"]
    assert wire.tell("", for_s=0.1) == LOCKED


@pytest.mark.parametrize("how", ["soft limit", "hard limit"])
def test_a_reset_before_the_message_that_asks_for_it_is_lost(how):
    wire = homed(settings={20: 1})
    if how == "soft limit":
        assert wire.ask("G53 G0 X5") == ["ALARM:2"]
    else:
        wire.device.set_limit_switch(closed=True)
        wire.device.set_limit_switch(closed=False)
        assert wire.tell("") == ["ALARM:1"]
    assert wire.tell("\x18?$$\n", for_s=0.6) == ["[MSG:Reset to continue]"]
    assert wire.tell("?$$\n$X\n", for_s=0.6) == []
    of_the_refused_line = ["ok"] if how == "soft limit" else []
    assert wire.tell("\x18") == [*of_the_refused_line, *LOCKED]


def test_a_homed_axis_stands_a_pull_off_inside_negative_space():
    low = homed(settings={27: 2.0, 130: 200.0}, switch_deg=-2.0)
    assert "MPos:-198.000" in low.report()
    high = homed(settings={23: 0, 27: 2.0, 130: 200.0}, switch_deg=6.0)
    assert "MPos:-2.000" in high.report()
    assert low.table_deg() == pytest.approx(0.0, abs=0.006)
    assert high.table_deg() == pytest.approx(4.0, abs=0.006)


def test_homing_answers_nothing_until_it_has_ended_then_all_at_once():
    wire = Wire()
    wire.tell("")
    assert wire.tell("$H\n??$G\n!", for_s=2.0) == []
    home, done, *queued = wire.tell("", for_s=15.0)
    assert home.startswith("<Home|")
    assert (done, queued[-1]) == ("ok", "ok")
    assert wire.report().startswith("<Idle|")


@pytest.mark.parametrize(
    ("options", "alarm"),
    [({"switch_deg": None}, "ALARM:9"), ({"mechanics": {"obstruction_deg": 2.0}}, "ALARM:9")],
)
def test_a_homing_that_finds_no_switch_says_ok_half_a_second_after_its_alarm(options, alarm):
    wire = Wire(**options)
    wire.tell("")
    assert wire.ask("$H", for_s=80.0) == [alarm, "ok", *LOCKED]


def test_a_switch_that_stays_closed_is_told_at_the_start_and_fails_the_homing():
    wire = Wire()
    wire.tell("")
    wire.device.set_limit_switch(closed=True)
    assert wire.tell("\x18") == [*BANNER, "[MSG:Check Limits]", LOCKED[-1]]
    assert "|Pn:X" in wire.report()
    assert wire.ask("$H", for_s=10.0)[:2] == ["ALARM:8", "ok"]


def test_a_switch_that_opens_is_an_alarm_too():
    wire = homed()
    wire.device.set_limit_switch(closed=True)
    wire.tell("", for_s=1.0)
    wire.tell("\x18")
    wire.ask("$X")
    wire.device.set_limit_switch(closed=False)
    assert wire.tell("") == ["ALARM:1"]


def test_reports_tell_the_work_offset_and_the_overrides_by_their_counters():
    wire = unhomed()
    extras = [wire.report().removesuffix(">").split("|")[3:] for _ in range(12)]
    offset, overrides = ["WCO:0.000,0.000,0.000"], ["Ov:100,100,100"]
    assert extras == [offset, overrides, *[[]] * 8, offset, overrides]
    wire.ask("G92 X5")
    assert "WCO:-5.000" in wire.report()
    wire.tell(b"\x91")
    assert "Ov:110,100,100" in wire.report()


@pytest.mark.parametrize(
    ("mask", "field"), [(0, "|WPos:7.000"), (1, "|MPos:0.000"), (2, "|WPos:7.000"), (3, "|MPos:0.000")]
)
def test_report_mask(mask, field):
    wire = unhomed()
    wire.tell(f"G10 L20 P1 X7\n$10={mask}\n")
    report = wire.report()
    assert field in report
    assert ("|Bf:15,128|" in report) == bool(mask & 2)


def test_many_questions_at_once_are_one():
    assert len(unhomed().tell("????")) == 1


def test_reports_in_inches():
    wire = unhomed()
    wire.ask("$13=1")
    wire.ask("G0 X25.4", for_s=3.0)
    assert "MPos:1.0000," in wire.report()


def test_settings_are_written_and_survive_a_reset():
    wire = unhomed()
    wire.tell("$110=600\n$20=1\n")
    assert wire.ask("$20=1") == ["error:10"]
    wire.tell("\x18")
    assert "$110=600.000" in wire.ask("$$")


def test_ok_comes_when_a_line_is_taken_and_g4_waits_for_the_motion():
    wire = unhomed()
    assert wire.ask("G0 X10", for_s=0.006) == ["ok"]
    assert wire.tell("?", for_s=0.004) == []
    assert wire.tell("", for_s=0.01)[0].startswith("<Run|")
    assert wire.ask("G4 P0", for_s=0.6) == []
    assert wire.tell("", for_s=0.2) == ["ok"]
    assert wire.report().startswith("<Idle|MPos:10.000")


def test_fifteen_lines_are_taken_at_once_and_what_overflows_the_buffer_is_lost():
    wire = unhomed()
    sent = "".join(f"G1 X{k} F200\n" for k in range(1, 54))
    assert wire.tell(sent, for_s=0.2) == ["ok"] * 15
    assert wire.tell("", for_s=60.0) == ["ok"] * 11


def test_blocks_in_one_direction_are_joined_without_a_stop():
    wire = unhomed()
    wire.tell("".join(f"G1 X{k} F600\n" for k in range(1, 6)), for_s=0.3)
    assert "FS:600" in wire.report()
    wire.tell("", for_s=0.32)
    assert "MPos:5.000" in wire.report()


def test_what_is_refused_while_it_moves():
    wire = unhomed()
    wire.ask("G0 X40")
    assert [wire.ask(line)[-1] for line in ("$$", "$#", "$I", "$N", "$H", "$C", "$10=1")] == ["error:8"] * 7
    assert [wire.ask(line)[-1] for line in ("$G", "$X")] == ["ok"] * 2


def test_a_hold_brakes_keeps_lines_and_goes_on():
    wire = unhomed()
    wire.ask("G0 X20", for_s=0.5)
    assert wire.tell("!?")[0].startswith("<Hold:1|")
    wire.tell("", for_s=0.3)
    assert wire.report().startswith("<Hold:0|")
    assert wire.tell("$G\n$$\n", for_s=1.0) == []
    assert [line for line in wire.tell("~") if not line.startswith("[GC")] == ["ok", "error:8"]
    wire.tell("", for_s=1.0)
    assert wire.report().startswith("<Idle|MPos:20.000")


def test_a_reset_from_a_hold_throws_the_rest_away_without_an_alarm():
    wire = unhomed()
    wire.ask("G0 X20", for_s=0.5)
    wire.tell("!", for_s=0.5)
    assert wire.tell("\x18") == BANNER
    place = wire.report()
    assert place.startswith("<Idle|")
    assert "MPos:20.000" not in place


def test_door_sleep_and_check():
    wire = unhomed()
    assert wire.tell(b"\x84") == ["[MSG:Check Door]"]
    assert wire.report().startswith("<Door:0|")
    assert wire.ask("$G") == []
    assert wire.tell("~")[-1] == "ok"
    wire.ask("$C")
    assert wire.ask("G0 X5") == ["ok"]
    assert wire.report().startswith("<Check|MPos:0.000")
    assert wire.ask("$C") == ["[MSG:Disabled]", "ok", *BANNER]
    assert wire.ask("$SLP") == ["ok", "[MSG:Sleeping]"]
    assert wire.ask("$G") == []
    assert wire.report().startswith("<Sleep|")
    assert wire.tell("\x18") == LOCKED


def test_a_jog_is_cancelled_and_refuses_g_code():
    wire = unhomed()
    assert wire.ask("$J=G91 X50 F1200", for_s=0.5) == ["ok"]
    assert wire.ask("G0 X0") == ["error:9"]
    assert wire.report().startswith("<Jog|")
    wire.tell(b"\x85", for_s=0.5)
    assert wire.report().startswith("<Idle|")
    assert wire.ask("$G")[0] == START


def test_0x85_does_nothing_to_a_move():
    wire = unhomed()
    wire.ask("G0 X20", for_s=0.3)
    wire.tell(b"\x85", for_s=2.0)
    assert "MPos:20.000" in wire.report()


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("ID", 2), ("1", 1), ("%", 1), ("G0 X1.2.3", 1), ("G0 X-", 2), ("G0 G1 X1", 24), ("G0 X1 X2", 25),
        ("G1 X1", 22), ("G1 X1 F-5", 4), ("T-1", 4), ("S-5", 4), ("T256", 38), ("G10 L2", 26),
        ("G10 L20 P9 X1", 29), ("P1", 36), ("G4", 28), ("G7", 20), ("M7", 20), ("H5 G0 X0", 20),
        ("G54.5", 23), ("G59 G54", 21), ("G43.1 X1", 37), ("G2 X1", 22), ("$100=", 2), ("$0=1", 6),
        ("$200=1", 3), ("$100=-5", 4), ("$H", 5), ("$GX", 3), ("$J=", 22), ("$J=G0 X1 F100", 16),
        ("$J=X1", 22), ("G0 X" + 90 * "0" + "1", 11), ("G1 X1 F100 " + 80 * "N", 11),
    ],
)  # fmt: skip
def test_a_bad_line_has_the_firmwares_own_number_and_moves_nothing(line, error):
    wire = unhomed()
    assert wire.ask(line) == [f"error:{error}"]
    wire.tell("", for_s=1.0)
    assert "MPos:0.000" in wire.report()


def test_a_jog_beyond_the_travel_is_refused_without_an_alarm():
    assert homed(settings={20: 1}).ask("$J=G91 X500 F600") == ["error:15"]


@pytest.mark.parametrize("line", ["(" + 100 * "c" + ")", "G0 X0" + 90 * " ", "g0/x0\t", "\x00G0X0", "$\xffG"])
def test_what_is_dropped_from_a_line(line):
    assert unhomed().ask(line)[-1] == "ok"


def test_cr_and_lf_are_an_end_each_and_real_time_bytes_act_inside_a_line():
    wire = unhomed()
    assert wire.tell("\r\n") == ["ok", "ok"]
    assert wire.tell("$?G\n")[0].startswith("<Idle|")


def test_a_blank_eeprom_is_told_and_filled():
    lines = Wire(blank_eeprom=True).tell("", for_s=0.2)
    assert lines[0] == "error:7"
    assert lines[-4:] == [*BANNER, ">:error:7", ">:error:7"]


def test_an_old_firmware_has_its_own_words():
    wire = Wire(firmware="0.9j")
    assert wire.tell("") == ["", "Grbl 0.9j ['$' for help]", "['$H'|'$X' to unlock]"]
    assert wire.ask("G0 X1") == ["error: Alarm lock"]
    wire.ask("$X")
    wire.tell("T211\nS211\n")
    assert wire.ask("$G")[0] == "[G0 G54 G17 G21 G90 G94 M0 M5 M9 T0 F0. S211.]"
    assert wire.report().startswith("<Idle,MPos:0.000,0.000,0.000,WPos:")
    assert wire.ask("$I") == ["[0.9j.20160726:]", "ok"]


def test_it_does_not_know_of_the_steps_it_loses():
    wire = unhomed(mechanics={"obstruction_deg": 30.0})
    wire.ask("G0 X60", for_s=5.0)
    assert "MPos:60.000" in wire.report()
    assert wire.table_deg() == pytest.approx(30.0)
    wire.ask("G0 X50", for_s=2.0)
    assert wire.table_deg() == pytest.approx(20.0)


def test_the_table_turns_as_the_count_says():
    wire = unhomed(mechanics={"power_up_deg": 0.0})
    wire.ask("G0 X30", for_s=0.8)
    wire.tell("!", for_s=1.0)
    wire.ask("", for_s=0.1)
    counted = float(wire.report().split("MPos:")[1].split(",")[0])
    assert wire.table_deg() == pytest.approx(counted, abs=0.006)


@pytest.mark.parametrize("fault", ["hang", "garbage", "echo"])
def test_faults_on_purpose(fault):
    wire = unhomed()
    sound = wire.ask("$$")
    wire.device.fault = fault
    heard = wire.tell("$$\n")
    if fault == "hang":
        assert heard == []
    elif fault == "garbage":
        assert not {*heard} & {*sound}
    else:
        assert heard[0].startswith("$$\n")


NAMES = recordings("grbl*")
LATE_S = 0.06
"""An answer comes within this of the recorded one."""
HOMING_LATE_S = 0.35
"""Of a cycle of seconds, whose ramps are the simulation's own."""
STEP_DEG = 0.021
JITTER_S = 0.014
BURST_JITTER_S = 0.022
"""After 600 bytes in one write."""
STOPPED_DEG = 0.45
"""Where a stop on the way ends: the instant at which it was sent is known to 20 ms."""
STOPS_ON_THE_WAY = ("!", "\x18", "\x84", "\x85")
RATE_PER_MIN = 320
HOMING = {
    "grbl11h-homing": {"switch_deg": -2.0},
    "grbl11h-homing-no-switch": {"switch_deg": None},
    "grbl11h-homing-switch-stuck": {"switch_deg": -2.0},
    "grbl11h-soft-limit-wco": {"switch_deg": -2.0},
}
BLANK = "grbl11h-power-up-blank-eeprom"
OPEN = "grbl11h-open-without-reset"

REPORT = re.compile(r"<(?P<state>\w+)(?::(?P<substate>\d))?[|,](?P<fields>.*)>")
FIELD = re.compile(r"[|,](?=[A-Z])")


def options(name: str) -> dict:
    if name == BLANK:
        return {"settings": {}, "blank_eeprom": True, "boot_s": 0.0}
    return HOMING.get(name, {})


def replayed(recording: Recording) -> tuple[list[tuple[float, str]], list[tuple[float, str]]]:
    """Lines that came in the recording, and from the simulated controller."""
    before = (b"G0 X8\nS211\n", b"?", b"?") if recording.name == OPEN else ()
    replay = Replay(recording, before, **options(recording.name))
    came, said = recording.came(), replay.lines()
    if recording.changes_baud:
        begin_s, end_s = AT_WRONG_BAUD_S
        said = [line for line in said if not begin_s < line[0] < end_s]
    if recording.name == BLANK:  # the first bytes of the recording are missing
        came, said = came[1:], said[said.index((said[0][0], said[0][1])) :]
        said = said[2:]
    return came, said


def parsed(line: str) -> tuple[str, str | None, dict[str, list[float] | str]]:
    found = REPORT.fullmatch(line)
    assert found, line
    fields: dict[str, list[float] | str] = {}
    for part in FIELD.split(found["fields"]):
        name, _, value = part.partition(":")
        fields[name] = value if name in ("Pn", "A") else [float(number) for number in value.split(",")]
    return found["state"], found["substate"], fields


@pytest.mark.parametrize("name", NAMES)
def test_it_says_what_the_firmware_said(name):
    recording = Recording(name)
    came, said = replayed(recording)
    answers, own = ([line for line in lines if line[1][:1] != "<"] for lines in (came, said))
    assert [line for _, line in own] == [line for _, line in answers]
    late_s = HOMING_LATE_S if name in HOMING else LATE_S
    for (at_s, line), (own_s, _) in zip(answers, own, strict=True):
        assert own_s == pytest.approx(at_s, abs=late_s), line


@pytest.mark.parametrize("name", NAMES)
def test_it_reports_what_the_firmware_reported(name):
    recording = Recording(name)
    came, said = replayed(recording)
    reports, own = (
        [(at_s, parsed(line)) for at_s, line in lines if line[:1] == "<"] for lines in (came, said)
    )
    assert len(own) == len(reports)
    stopped_s = min(
        (
            at_s
            for at_s, kind, text in recording.entries
            if kind == "to" and set(text) & set(STOPS_ON_THE_WAY)
        ),
        default=float("inf"),
    )
    stopped_s = min([stopped_s, *(at_s for at_s, kind, _ in recording.entries if kind == "event" and at_s)])
    inches = 25.4 if recording.name == "grbl11h-inches" else 1.0
    for k, ((at_s, report), (_, its_own)) in enumerate(zip(reports, own, strict=True)):
        state, substate, fields = report
        around = {other[:2] for _, other in own[max(k - 1, 0) : k + 2]}  # a state changes within 50 ms
        assert (state, substate) in around, (at_s, report, its_own)
        assert list(its_own[2]) == list(fields), (at_s, report, its_own)
        rates = [values["FS"][0] for values in (fields, its_own[2]) if "FS" in values]
        moves_dps = max([0.0, *rates]) / 60 * (inches if rates and max(rates) < 100 else 1.0)
        if not rates and state in ("Run", "Hold"):
            moves_dps = 500 / 60
        jitter_s = BURST_JITTER_S if recording.name == "grbl11h-rx-overflow" else JITTER_S
        for field, value in fields.items():
            if field in ("MPos", "WPos"):
                loose = STOPPED_DEG if at_s >= stopped_s else 0.0
                assert its_own[2][field] == pytest.approx(
                    value, abs=STEP_DEG + loose + jitter_s * max(moves_dps, 1.0)
                ), (at_s, report, its_own)
            elif field == "FS":
                assert its_own[2]["FS"] == pytest.approx(value, abs=RATE_PER_MIN), (at_s, report, its_own)
            elif field == "Bf":
                assert its_own[2]["Bf"] == pytest.approx(value, abs=1), (at_s, report, its_own)
            else:
                assert its_own[2][field] == value, (at_s, report, its_own)
