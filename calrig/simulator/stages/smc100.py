"""The stage's dialect: a Newport SMC100's commands and errors.

Its source is the manual (SMC100CC/PP user's manual, EDH0206En) as `../shared/stages.md` next to the
repository gives it. No conversation with a real one was recorded: what the manual leaves open is this
module's guess.
"""

import re
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from calrig.simulator.bench import Bench
from calrig.simulator.config import StageOptions
from calrig.simulator.stage import LineStage, Refused

NO_ERROR = "@"
ERROR_TEXTS = {
    "@": "No error",
    "A": "Unknown message code or floating point controller address",
    "B": "Controller address not correct",
    "C": "Parameter missing or out of range",
    "D": "Command not allowed",
    "E": "Home sequence already started",
    "G": "Displacement out of limits",
    "H": "Command not allowed in NOT REFERENCED state",
    "I": "Command not allowed in CONFIGURATION state",
    "J": "Command not allowed in DISABLE state",
    "K": "Command not allowed in READY state",
    "L": "Command not allowed in HOMING state",
    "M": "Command not allowed in MOVING state",
    "N": "Current position out of software limit",
    "S": "Communication time-out",
    "U": "Error during EEPROM access",
    "V": "Error during command execution",
    "W": "Command not allowed for PP version",
    "X": "Command not allowed for CC version",
}
FOLLOWING_ERROR = 1 << 5
HOMING_TIME_OUT = 1 << 6


class State(IntEnum):
    """The controller's states, by the code that `TS` gives; the names say where each was entered from."""

    NOT_REFERENCED_FROM_RESET = 0x0A
    NOT_REFERENCED_FROM_HOMING = 0x0B
    HOMING = 0x1E
    MOVING = 0x28
    READY_FROM_HOMING = 0x32
    READY_FROM_MOVING = 0x33
    READY_FROM_DISABLE = 0x34
    DISABLE_FROM_READY = 0x3C
    DISABLE_FROM_MOVING = 0x3D


NOT_REFERENCED = {State.NOT_REFERENCED_FROM_RESET, State.NOT_REFERENCED_FROM_HOMING}
READY = {State.READY_FROM_HOMING, State.READY_FROM_MOVING, State.READY_FROM_DISABLE}
DISABLE = {State.DISABLE_FROM_READY, State.DISABLE_FROM_MOVING}
REFUSALS = (
    (NOT_REFERENCED, "H"),
    (DISABLE, "J"),
    (READY, "K"),
    ({State.HOMING}, "L"),
    ({State.MOVING}, "M"),
)


FIRMWARE = "SMC100CC simulated"
COMMAND_FORM = re.compile(r"(\d{0,2})([A-Z]{2})(.*)")


class _Ahead(NamedTuple):
    """What the state will be once the motion under way has ended."""

    at_s: float
    state: State
    errors: int = 0


class Smc100(LineStage):
    """A controller with one stage, fed with bytes, answering in bytes."""

    dropped = b" \t\r\x11\x13\x00"
    """Blanks count for nothing anywhere in a command; XON and XOFF belong to the line."""

    def __init__(self, options: StageOptions, bench: Bench, now: Callable[[], float]) -> None:
        super().__init__(options, bench, now)
        self._memory = NO_ERROR
        self._handlers: dict[str, Callable[[float, str], str | None]] = {
            "OR": self._home,
            "PA": lambda now_s, target: self._move(now_s, target, 0.0, "N"),
            "PR": lambda now_s, way: self._move(now_s, way, self._setpoint_deg, "G"),
            "TP": lambda now_s, _: _number(self._reported_deg(now_s)),
            "TS": lambda *_: f"{self._errors:04X}{self._state:02X}",
            "TE": self._take_error,
            "TB": lambda _, letter: self._error_text(letter),
            "ST": self._stop,
            "VA": lambda _, value: self._parameter("VA", value),
            "AC": lambda _, value: self._parameter("AC", value),
            "SL": lambda _, value: self._parameter("SL", value),
            "SR": lambda _, value: self._parameter("SR", value),
            "MM": self._switch_motor,
            "RS": lambda now_s, _: self._reset(now_s),
            "VE": lambda *_: f" {options.firmware or FIRMWARE}",
        }
        self._power_up()

    @property
    def state(self) -> State:
        """The state the controller is in now."""
        with self._at_now():
            return self._state

    def reset(self) -> None:
        """It is switched off and on."""
        with self._at_now() as now_s:
            self._reset(now_s)

    def _replies(self, line: bytes) -> list[str]:
        try:
            reply = self._answer(line.decode("ascii", "replace").upper())
        except Refused as refusal:
            self._memory, reply = refusal.answer, None
        return [] if reply is None else [reply]

    def _answer(self, line: str) -> str | None:
        command = COMMAND_FORM.fullmatch(line)
        if command is None:
            if line:
                raise Refused("A")
            return None
        address, code, parameter = command.groups()
        to_all = address in {"", "0"} and code == "ST"
        if not to_all and address != str(self._options.axis):
            return None  # another controller's on the same line
        handler = self._handlers.get(code)
        if handler is None:
            raise Refused("A")
        with self._at_now() as now_s:
            value = handler(now_s, parameter)
        asked = parameter.removesuffix("?") if code == "TB" else ""
        return None if value is None else f"{self._options.axis}{code}{asked}{value}"

    def _power_up(self) -> None:
        self._state = State.NOT_REFERENCED_FROM_RESET
        self._errors = 0
        self._ahead: _Ahead | None = None
        low, high = self._options.limits_deg
        self._parameters = {
            "VA": self._options.velocity_dps,
            "AC": self._options.acceleration_dps2,
            "SL": low,
            "SR": high,
        }
        self._setpoint_deg = 0.0

    def _advance(self, now_s: float) -> None:
        if self._ahead and now_s >= self._ahead.at_s:
            _, self._state, errors = self._ahead
            self._errors |= errors
            self._ahead = None

    def _only_in(self, *allowed: set[State]) -> None:
        if not any(self._state in states for states in allowed):
            raise Refused(next(letter for states, letter in REFUSALS if self._state in states))

    def _home(self, now_s: float, _: str) -> None:
        self._only_in(NOT_REFERENCED)
        arrival = self._search_home(now_s)
        self._state, self._errors, self._setpoint_deg = State.HOMING, 0, 0.0
        self._ahead = (
            _Ahead(arrival.at_s, State.NOT_REFERENCED_FROM_HOMING, FOLLOWING_ERROR | HOMING_TIME_OUT)
            if arrival.stalled
            else _Ahead(arrival.at_s, State.READY_FROM_HOMING)
        )

    def _move(self, now_s: float, parameter: str, from_deg: float, out_of_limits: str) -> str | None:
        if parameter == "?":
            return _number(self._setpoint_deg)
        target_deg = from_deg + _parsed(parameter)
        self._only_in(READY)
        if not self._parameters["SL"] <= target_deg <= self._parameters["SR"]:
            raise Refused(out_of_limits)
        if target_deg == self._setpoint_deg:
            return None
        arrival = self._bench.mechanics.move(
            now_s, target_deg, self._parameters["VA"], self._parameters["AC"]
        )
        self._state, self._setpoint_deg = State.MOVING, target_deg
        self._ahead = (
            _Ahead(arrival.at_s, State.DISABLE_FROM_MOVING, FOLLOWING_ERROR)
            if arrival.stalled
            else _Ahead(arrival.at_s, State.READY_FROM_MOVING)
        )
        return None

    def _halt(self, now_s: float) -> float:
        rest_s = self._bench.mechanics.halt(now_s, self._parameters["AC"])
        self._setpoint_deg = self._encoder_deg(rest_s)
        return rest_s

    def _stop(self, now_s: float, _: str) -> None:
        if self._state == State.MOVING:
            self._ahead = _Ahead(self._halt(now_s), State.READY_FROM_MOVING)
        elif self._state == State.HOMING:
            self._ahead = _Ahead(self._halt(now_s), State.NOT_REFERENCED_FROM_HOMING)

    def _switch_motor(self, now_s: float, parameter: str) -> str | None:
        if parameter == "?":
            return f"{self._state:02X}"
        if parameter == "0":
            self._only_in(READY, {State.MOVING})
            moving = self._state == State.MOVING
            if moving:
                self._halt(now_s)
            self._state = State.DISABLE_FROM_MOVING if moving else State.DISABLE_FROM_READY
            self._ahead = None
        elif parameter == "1":
            self._only_in(DISABLE)
            self._state, self._errors = State.READY_FROM_DISABLE, 0
            self._setpoint_deg = self._encoder_deg(now_s)
        else:
            raise Refused("C")
        return None

    def _reset(self, now_s: float) -> None:
        if self._ahead:
            self._halt(now_s)
        self._power_up()
        self._memory = NO_ERROR

    def _parameter(self, code: str, parameter: str) -> str | None:
        if parameter == "?":
            return _number(self._parameters[code])
        value = _parsed(parameter)
        self._only_in(READY, DISABLE)
        in_range = {"SL": value <= 0, "SR": value >= 0}.get(code, value > 0)
        if not in_range:
            raise Refused("C")
        self._parameters[code] = value
        return None

    def _take_error(self, _now_s: float, _: str) -> str:
        letter, self._memory = self._memory, NO_ERROR
        return letter

    def _error_text(self, letter: str) -> str:
        named = letter.removesuffix("?") or self._memory
        if named not in ERROR_TEXTS:
            raise Refused("C")
        return f" {ERROR_TEXTS[named]}" if letter.removesuffix("?") else f"{named} {ERROR_TEXTS[named]}"


STAGE = Smc100


def _parsed(parameter: str) -> float:
    if not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(E[-+]?\d{1,2})?", parameter):
        raise Refused("C")
    return float(parameter)


def _number(value: float) -> str:
    text = f"{value:.5f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
