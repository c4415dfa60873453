"""The dialects of the stages' controllers, spoken to without a wire, on a clock that the test turns."""

from __future__ import annotations

import pytest

from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import stage_of
from calrig.simulator.stages.smc100 import Smc100


class Controller:
    """A controller and the hand on its clock."""

    def __init__(self, **options) -> None:
        settings = SimulatorSettings.from_options({"preset": "ideal"} | options)
        self.now_s = 0.0
        self.device = Smc100(settings.stage, Bench(settings), lambda: self.now_s)

    def ask(self, command: str, after_s: float = 0.0) -> str:
        self.now_s += after_s
        return self.device.receive(command.encode() + b"\r\n").decode().removesuffix("\r\n")

    def refused(self, command: str) -> str:
        """Sends a command that answers nothing; returns the error letter it left."""
        assert self.ask(command) == ""
        return self.ask("1TE")[-1]

    def homed(self) -> Controller:
        assert self.refused("1OR") == "@"
        assert self.ask("1TS", after_s=60) == "1TS000032"
        return self


def test_it_is_not_referenced_until_it_has_homed_in_finite_time():
    stage = Controller()
    assert stage.ask("1TS") == "1TS00000A"
    assert stage.refused("1OR") == "@"
    assert stage.ask("1TS") == "1TS00001E"
    assert stage.ask("1TS", after_s=0.2) == "1TS00001E"
    assert stage.ask("1TS", after_s=30) == "1TS000032"
    assert stage.ask("1TP") == "1TP0"


def test_a_move_takes_its_time_and_arrives():
    stage = Controller(stage={"velocity_dps": 20.0, "acceleration_dps2": 80.0}).homed()
    assert stage.refused("1PA-30.5") == "@"
    assert stage.ask("1TS") == "1TS000028"
    assert stage.ask("1TP", after_s=1.0) == "1TP-17.5"  # 20·1 s less half a ramp of 20²/80
    assert stage.ask("1TS", after_s=0.77) == "1TS000028"
    assert stage.ask("1TS", after_s=0.01) == "1TS000033"
    assert stage.ask("1TP") == "1TP-30.5"
    assert stage.ask("1PA?") == "1PA-30.5"


def test_relative_moves_add_up_from_the_setpoint():
    stage = Controller().homed()
    for _ in range(3):
        stage.ask("1PR1.5")
        stage.now_s += 10
    assert stage.ask("1TP") == "1TP4.5"


def test_a_move_to_where_it_is_never_leaves_ready():
    stage = Controller().homed()
    assert stage.refused("1PA0") == "@"
    assert stage.ask("1TS") == "1TS000032"


@pytest.mark.parametrize(("command", "letter"), [("1PA176", "N"), ("1PA-175.1", "N"), ("1PR180", "G")])
def test_a_target_out_of_limits_shows_only_in_the_error_memory(command, letter):
    stage = Controller().homed()
    assert stage.ask(command) == ""
    assert stage.ask("1TS") == "1TS000032"
    assert stage.ask("1TE") == f"1TE{letter}"
    assert stage.ask("1TE") == "1TE@"
    assert stage.ask("1TP") == "1TP0"


@pytest.mark.parametrize(
    ("state", "command", "letter"),
    [
        ("not_referenced", "1PA10", "H"),
        ("not_referenced", "1PR10", "H"),
        ("not_referenced", "1VA10", "H"),
        ("not_referenced", "1MM0", "H"),
        ("homing", "1OR", "L"),
        ("homing", "1PA10", "L"),
        ("moving", "1PA10", "M"),
        ("moving", "1OR", "M"),
        ("moving", "1VA5", "M"),
        ("ready", "1OR", "K"),
        ("ready", "1MM1", "K"),
        ("disabled", "1PA10", "J"),
        ("disabled", "1OR", "J"),
    ],
)
def test_what_a_state_does_not_allow_is_refused_with_its_letter_and_moves_nothing(state, command, letter):
    stage = Controller()
    if state != "not_referenced":
        stage.ask("1OR")
    if state in {"moving", "ready", "disabled"}:
        stage.now_s += 60
    if state == "moving":
        stage.ask("1PA90")
    if state == "disabled":
        stage.ask("1MM0")
    status, position = stage.ask("1TS"), stage.ask("1TP")
    assert stage.refused(command) == letter
    assert (stage.ask("1TS"), stage.ask("1TP")) == (status, position)


@pytest.mark.parametrize(
    ("command", "letter"),
    [("1QQ", "A"), ("1PAabc", "C"), ("1PA", "C"), ("1VA-5", "C"), ("1SL5", "C"), ("1MM7", "C"), ("??", "A")],
)
def test_what_it_cannot_read_is_remembered(command, letter):
    assert Controller().homed().refused(command) == letter


def test_parameters_are_read_back_and_used():
    stage = Controller().homed()
    assert [stage.ask(query) for query in ("1VA?", "1AC?", "1SL?", "1SR?")] == [
        "1VA20",
        "1AC80",
        "1SL-175",
        "1SR175",
    ]
    for command in ("1VA40", "1AC400", "1SL-20", "1SR20"):
        assert stage.refused(command) == "@"
    assert stage.refused("1PA20.5") == "N"
    stage.ask("1PA20")
    assert stage.ask("1TS", after_s=20 / 40 + 40 / 400 - 0.001) == "1TS000028"
    assert stage.ask("1TS", after_s=0.002) == "1TS000033"


@pytest.mark.parametrize("stop", ["1ST", "ST", "0ST"])
def test_stop_decelerates_and_leaves_it_ready_where_it_stands(stop):
    stage = Controller().homed()
    stage.ask("1PA90")
    stage.ask(stop, after_s=1.0)
    assert stage.ask("1TS") == "1TS000028"
    assert stage.ask("1TS", after_s=0.26) == "1TS000033"
    assert stage.ask("1TP") == "1TP20"  # 17.5 after one second, and a ramp of 2.5 to stop in
    assert stage.ask("1TP", after_s=10) == "1TP20"


def test_stop_while_homing_leaves_it_not_referenced():
    stage = Controller()
    stage.ask("1OR")
    stage.ask("1ST", after_s=0.2)
    assert stage.ask("1TS", after_s=1.0) == "1TS00000B"
    stage.homed()


def test_motor_off_and_on():
    stage = Controller().homed()
    stage.ask("1MM0")
    assert stage.ask("1TS") == "1TS00003C"
    stage.ask("1MM1")
    assert stage.ask("1TS") == "1TS000034"
    stage.ask("1PA90")
    stage.ask("1MM0", after_s=1.0)
    assert stage.ask("1TS") == "1TS00003D"
    assert stage.ask("1TS", after_s=60) == "1TS00003D"


def test_reset_forgets_the_reference():
    stage = Controller().homed()
    stage.ask("1PA90")
    stage.ask("1RS", after_s=1.0)
    assert stage.ask("1TS") == "1TS00000A"
    assert stage.refused("1PA10") == "H"


def test_a_stall_ends_in_disable_with_a_following_error():
    stage = Controller(mechanics={"obstruction_deg": 30.0}).homed()
    stage.ask("1PA60")
    assert stage.ask("1TS", after_s=60) == "1TS00203D"
    assert stage.ask("1TP") == "1TP30"
    assert stage.refused("1MM1") == "@"
    assert stage.refused("1PA0") == "@"
    assert stage.ask("1TS", after_s=60) == "1TS000033"


def test_homing_into_an_obstruction_times_out():
    stage = Controller(mechanics={"obstruction_deg": 2.0})
    stage.ask("1OR")
    assert stage.ask("1TS", after_s=60) == "1TS00600B"


def test_error_texts_and_version():
    stage = Controller()
    assert stage.ask("1TBH") == "1TBH Command not allowed in NOT REFERENCED state"
    stage.ask("1PA3")
    assert stage.ask("1TB") == "1TBH Command not allowed in NOT REFERENCED state"
    assert stage.ask("1VE") == "1VE SMC100CC simulated"


def test_it_answers_to_its_own_address_only():
    stage = Controller(stage={"axis": 12})
    assert stage.ask("1TS") == ""
    assert stage.ask("TS") == ""
    assert stage.ask("12TS") == "12TS00000A"


def test_commands_cut_in_pieces_with_blanks_and_small_letters_are_understood():
    stage = Controller()
    assert stage.device.receive(b"1t") == b""
    assert stage.device.receive(b" s\r\n1VA?\r") == b"1TS00000A\r\n"
    assert stage.device.receive(b"\n") == b"1VA20\r\n"


def test_faults_on_purpose():
    stage = Controller(stage={"fault": "hang"})
    assert stage.ask("1TS") == ""
    stage.device.fault = "echo"
    assert stage.ask("1TS") == "1TS\r\n1TS00000A"
    stage.device.fault = "garbage"
    garbage = stage.device.receive(b"1TS\r\n")
    assert garbage.endswith(b"\r\n")
    assert b"TS" not in garbage
    stage.device.fault = None
    assert stage.ask("1TS") == "1TS00000A"


class LineController:
    """A controller of any driver and the hand on its clock; it answers in lines."""

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


def esp301(**options) -> LineController:
    return LineController("esp301", b"\r", **options)


def zaber(**options) -> LineController:
    return LineController("zaber", b"\n", **options)


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
def test_faults_on_purpose_of_esp301_and_zaber(make):
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
