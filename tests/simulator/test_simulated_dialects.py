"""The ESP301's and Zaber's dialects, spoken to without a wire, on a clock that the test turns."""

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


def esp301(**options) -> Controller:
    return Controller("esp301", b"\r", **options)


def zaber(**options) -> Controller:
    return Controller("zaber", b"\n", **options)


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


@pytest.mark.parametrize("make", [esp301, zaber])
def test_faults_on_purpose(make):
    controller = make()
    controller.tell(b"")
    ask = {esp301: b"1TP?\r", zaber: b"/1 1 get pos\n"}[make]
    sound = controller.tell(ask)
    controller.device.fault = "hang"
    assert controller.tell(ask) == []
    controller.device.fault = "garbage"
    assert not {*controller.device.receive(ask).decode("latin-1").split("\r\n")} & {*sound}
    controller.device.fault = "echo"
    assert controller.device.receive(ask).startswith(ask[:-1])
