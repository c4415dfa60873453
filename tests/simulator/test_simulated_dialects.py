"""GRBL's, the ESP301's and Zaber's dialects, spoken to without a wire, on a clock that the test turns."""

from __future__ import annotations

import pytest

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import stage_of


class Controller:
    """A controller and the hand on its clock."""

    def __init__(self, driver: str, line_end: bytes, **options) -> None:
        settings = SimulatorSettings.from_options({"preset": "ideal"} | options)
        stage = settings.stage.model_copy(update={"driver": driver})
        self.now_s = 0.0
        self.device = stage_of(driver)(stage, Bench(settings), lambda: self.now_s)
        self._line_end = line_end

    def tell(self, data: bytes, after_s: float = 0.0) -> list[str]:
        self.now_s += after_s
        return [line for line in self.device.receive(data).decode().split("\r\n") if line]

    def ask(self, command: str, after_s: float = 0.0) -> list[str]:
        return self.tell(command.encode() + self._line_end, after_s)


def grbl(**options) -> Controller:
    return Controller("grbl", b"\n", **options)


def esp301(**options) -> Controller:
    return Controller("esp301", b"\r", **options)


def zaber(**options) -> Controller:
    return Controller("zaber", b"\n", **options)


def homed_grbl(**options) -> Controller:
    controller = grbl(**options)
    controller.tell(b"")
    assert controller.ask("$H") == []
    assert controller.ask("", after_s=30) == ["ok", "ok"]  # homing's own, and the empty line's
    return controller


def test_grbl_greets_and_is_locked_until_it_is_homed_or_unlocked():
    controller = grbl()
    assert controller.tell(b"") == ["Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]"]
    assert controller.tell(b"?") == ["<Alarm|MPos:0.000,0.000,0.000|FS:0,0>"]
    assert controller.ask("G0 X10") == ["error:9"]
    assert controller.ask("$X") == ["[MSG:Caution: Unlocked]", "ok"]
    assert controller.tell(b"?") == ["<Idle|MPos:0.000,0.000,0.000|FS:0,0>"]


def test_grbl_says_nothing_while_it_homes_and_ok_at_the_end():
    controller = grbl()
    controller.tell(b"")
    assert controller.ask("$H") == []
    assert controller.tell(b"?") == []
    assert controller.tell(b"", after_s=30) == ["ok"]
    assert controller.tell(b"?") == ["<Idle|MPos:0.000,0.000,0.000|FS:0,0>"]


def test_grbl_lists_its_settings_unless_it_runs():
    controller = homed_grbl(stage={"velocity_dps": 20.0, "acceleration_dps2": 80.0})
    lines = controller.ask("$$")
    assert lines[-1] == "ok"
    assert {"$22=1", "$20=1", "$100=200.000", "$110=1200.000", "$120=80.000", "$130=175.000"} <= {*lines}
    controller.ask("G0 X90")
    assert controller.ask("$$") == ["error:8"]


def test_grbl_accepts_a_move_at_once_and_has_arrived_when_it_is_idle():
    controller = homed_grbl(stage={"velocity_dps": 20.0, "acceleration_dps2": 80.0})
    assert controller.ask("G90 G21 G1 X-30.5 F600") == ["ok"]
    assert controller.tell(b"?", after_s=1.0)[0].startswith(
        "<Run|MPos:-9.375,"
    )  # 10·1 s less a ramp of 10²/160
    assert controller.tell(b"?", after_s=2.17)[0].startswith("<Run|")
    assert controller.tell(b"?", after_s=0.01) == ["<Idle|MPos:-30.500,0.000,0.000|FS:0,0>"]


def test_grbl_holds_resumes_and_loses_its_place_when_it_is_reset_on_the_move():
    controller = homed_grbl()
    controller.ask("G0 X90")
    assert controller.tell(b"!?", after_s=1.0)[0].startswith("<Hold:1|")
    assert controller.tell(b"?", after_s=1.0) == ["<Hold:0|MPos:20.000,0.000,0.000|FS:0,0>"]
    assert controller.tell(b"~?")[0].startswith("<Run|")
    assert controller.tell(b"\x18", after_s=1.0)[0] == "ALARM:3"
    assert controller.tell(b"?")[0].startswith("<Alarm|")


def test_grbl_reset_in_hold_throws_the_rest_away_and_keeps_its_place():
    controller = homed_grbl()
    controller.ask("G0 X90")
    controller.tell(b"!", after_s=1.0)
    controller.tell(b"\x18", after_s=1.0)
    assert controller.tell(b"?", after_s=60) == ["<Idle|MPos:20.000,0.000,0.000|FS:0,0>"]


def test_grbl_refuses_a_target_beyond_its_travel_with_an_alarm_and_keeps_its_place():
    controller = homed_grbl()
    assert controller.ask("G0 X176") == ["ALARM:2", "[MSG:Reset to continue]"]
    assert controller.tell(b"?") == []
    assert controller.tell(b"\x18")[0].startswith("Grbl")
    assert controller.tell(b"?") == ["<Alarm|MPos:0.000,0.000,0.000|FS:0,0>"]


def test_grbl_says_nothing_after_a_hard_limit_until_it_is_reset():
    """Neither `?` nor `$$`: its main loop waits for the reset (grbl/protocol.c, protocol_exec_rt_system)."""
    controller = homed_grbl()
    controller.ask("G0 X90")
    controller.now_s += 1.0
    controller.device.close_limit_switch()
    assert controller.tell(b"?") == ["ALARM:1", "[MSG:Reset to continue]"]
    assert controller.tell(b"?$$\n") == []
    assert controller.tell(b"\x18")[0].startswith("Grbl")
    assert controller.tell(b"?")[0].startswith("<Alarm|")


def test_grbl_hears_no_line_while_it_holds():
    controller = homed_grbl()
    controller.ask("G0 X90")
    controller.tell(b"!", after_s=1.0)
    assert controller.ask("$G", after_s=1.0) == []
    assert controller.tell(b"~")[-1] == "ok"


def test_grbl_keeps_units_distance_and_tool_until_it_is_reset():
    controller = homed_grbl()
    controller.ask("G20 G91 T211 G0 X1")
    assert controller.ask("$G", after_s=60) == ["[GC:G0 G54 G17 G20 G91 G94 M5 M9 T211 F0 S0]", "ok"]
    assert controller.ask("X1") == ["ok"]
    assert controller.tell(b"?", after_s=60) == ["<Idle|MPos:50.800,0.000,0.000|FS:0,0>"]
    controller.tell(b"\x18")
    assert controller.ask("$G") == ["[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]", "ok"]


def test_grbl_before_1_1_reports_in_commas():
    controller = grbl(stage={"firmware": "0.9j"})
    assert controller.tell(b"") == ["Grbl 0.9j ['$' for help]", "['$H'|'$X' to unlock]"]
    assert controller.tell(b"?") == ["<Alarm,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>"]
    assert controller.ask("$I") == ["[0.9j.20190830:]", "ok"]


@pytest.mark.parametrize(
    ("line", "error"), [("$Q", 3), ("G0 X1.2.3", 2), ("G2 X1", 20), ("G1 X5", 22), ("G0X" + 80 * "1", 11)]
)
def test_grbl_refuses_what_it_cannot_read(line, error):
    assert homed_grbl().ask(line) == [f"error:{error}"]


def test_grbl_does_not_know_of_the_steps_it_loses():
    controller = homed_grbl(mechanics={"obstruction_deg": 30.0})
    controller.ask("G0 X60")
    assert controller.tell(b"?", after_s=60) == ["<Idle|MPos:60.000,0.000,0.000|FS:0,0>"]


def test_grbl_without_homing_counts_from_where_it_is_switched_on():
    controller = grbl(stage={"homing": False})
    controller.tell(b"")
    assert controller.ask("$H") == ["error:5"]
    controller.ask("G0 X40")
    controller.now_s += 60
    controller.device.reset()
    assert controller.tell(b"")[0].startswith("Grbl")
    assert controller.tell(b"?") == ["<Idle|MPos:0.000,0.000,0.000|FS:0,0>"]


def test_esp301_answers_bare_numbers():
    controller = esp301()
    queries = ("1TP?", "1MD?", "1VA?", "1SL?", "1SR?", "VE?", "1ID?", "TE?")
    assert [controller.ask(query)[0] for query in queries] == [
        "0.0000", "1", "20.0000", "-175.0000", "175.0000",
        "ESP301 Version 3.0.1 simulated", "URS75BCC, SN S0001", "0",
    ]  # fmt: skip


def test_esp301_moves_and_says_when_it_is_done():
    controller = esp301()
    assert controller.ask("1PA10") == []
    assert controller.ask("1MD?") == ["0"]
    assert controller.ask("1MD?", after_s=10) == ["1"]
    assert controller.ask("1PR5;1TP?", after_s=0) == ["10.0000"]
    assert controller.ask("1TP?", after_s=10) == ["15.0000"]
    controller.ask("1PA90")
    controller.ask("1ST", after_s=1.0)
    assert controller.ask("1TP?", after_s=10) == controller.ask("1TP?", after_s=10)
    controller.ask("1OR1")
    assert controller.ask("1TP?", after_s=60) == ["0.0000"]


@pytest.mark.parametrize(
    ("command", "code", "text"),
    [
        ("1PA176", 104, "POSITIVE HARDWARE LIMIT DETECTED"),
        ("1PA-176", 105, "NEGATIVE HARDWARE LIMIT DETECTED"),
        ("1VA21", 110, "MAXIMUM VELOCITY EXCEEDED"),
        ("1QQ", 6, "COMMAND DOES NOT EXIST"),
        ("9PA1", 9, "AXIS NUMBER OUT OF RANGE"),
        ("1PA", 38, "COMMAND PARAMETER MISSING"),
    ],
)
def test_esp301_shows_what_it_refused_only_when_asked_and_once(command, code, text):
    controller = esp301()
    assert controller.ask(command) == []
    assert controller.ask("TB?") == [f"{code}, 0, {text}"]
    assert controller.ask("TB?") == ["0, 0, NO ERROR DETECTED"]
    controller.ask(command)
    assert controller.ask("TE?") == [str(code)]
    assert controller.ask("TE?") == ["0"]


def test_esp301_with_its_motor_off_does_not_move():
    controller = esp301()
    controller.ask("1MF")
    controller.ask("1PA10")
    assert controller.ask("TE?") == ["113"]
    controller.ask("1MO")
    controller.ask("1PA10")
    assert controller.ask("1TP?", after_s=10) == ["10.0000"]


def test_zaber_numbers_come_back_with_a_checksum():
    controller = zaber()
    assert controller.ask("/1 1 05 get pos:27") == ["@01 1 05 OK IDLE WR 0:B8"]
    assert controller.ask("/1 1 05 get pos:28") == []  # damaged on the way
    assert controller.ask("/2 1 05 get pos") == []
    assert controller.ask("/1 1 get limit.cycle.dist") == ["@01 1 OK IDLE WR 2304000"]
    assert controller.ask("/1 1 get nothing") == ["@01 1 RJ IDLE WR BADCOMMAND"]


def test_zaber_homes_moves_stops_and_flags():
    controller = zaber(mechanics={"obstruction_deg": 100.0})
    assert controller.ask("/1 1 home") == ["@01 1 OK BUSY WR 0"]
    assert controller.ask("/1 1", after_s=60) == ["@01 1 OK IDLE -- 0"]
    assert controller.ask("/1 1 move abs 64000") == ["@01 1 OK BUSY -- 0"]
    assert controller.ask("/1 1 get pos", after_s=60) == ["@01 1 OK IDLE -- 64000"]
    assert controller.ask("/1 1 move abs 9999999") == ["@01 1 RJ IDLE -- BADDATA"]
    controller.ask("/1 1 move abs -64000")
    controller.ask("/1 1 stop", after_s=0.2)
    assert controller.ask("/1 1 warnings", after_s=60) == ["@01 1 OK IDLE NI 01 NI"]
    controller.ask("/1 1 warnings clear")
    controller.ask("/1 1 move abs 1000000")
    assert controller.ask("/1 1", after_s=60) == ["@01 1 OK IDLE FS 0"]


@pytest.mark.parametrize("make", [grbl, esp301, zaber])
def test_faults_on_purpose(make):
    controller = make()
    controller.tell(b"")
    ask = {grbl: b"$$\n", esp301: b"1TP?\r", zaber: b"/1 1 get pos\n"}[make]
    sound = controller.tell(ask)
    controller.device.fault = "hang"
    assert controller.tell(ask) == []
    controller.device.fault = "garbage"
    assert not {*controller.device.receive(ask).decode("latin-1").split("\r\n")} & {*sound}
    controller.device.fault = "echo"
    assert controller.device.receive(ask).startswith(ask[:-1])
