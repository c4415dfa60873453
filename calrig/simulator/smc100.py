"""The stage's dialect: a Newport SMC100's commands, states and errors (SMC100CC/PP user's manual, EDH0206En).

Motion is `mechanics`' business; here is only what the controller says, allows and remembers.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from calrig.simulator.bench import Bench
from calrig.simulator.config import StageFault, StageOptions
from calrig.simulator.smc100_codes import (
    DISABLE,
    ERROR_TEXTS,
    FOLLOWING_ERROR,
    HOMING_TIME_OUT,
    NO_ERROR,
    NOT_REFERENCED,
    READY,
    REFUSALS,
    State,
)

FIRMWARE = "SMC100CC simulated"
LONGEST_COMMAND = 64
COMMAND_FORM = re.compile(r"(\d{0,2})([A-Z]{2})(.*)")
IGNORED = b" \t\r\x11\x13\x00"
"""Blanks count for nothing anywhere in a command; XON and XOFF belong to the line."""
GARBLED = bytes(byte ^ 0x55 for byte in range(256))


class _Refused(Exception):  # noqa: N818 (a letter of the dialect, caught where it is remembered)
    def __init__(self, letter: str) -> None:
        self.letter = letter


class _Ahead(NamedTuple):
    """What the state will be once the motion under way has ended."""

    at_s: float
    state: State
    errors: int = 0


class Smc100:
    """A controller with one stage, fed with bytes, answering in bytes.

    Attributes:
        fault: breaks it on purpose, at any time: `hang`, `garbage`, `echo` or None.
    """

    interval_s = None
    """It never speaks unasked."""

    def __init__(self, options: StageOptions, bench: Bench, now: Callable[[], float]) -> None:
        self.fault: StageFault | None = options.fault
        self._options = options
        self._bench = bench
        self._now = now
        self._tail = b""
        self._memory = NO_ERROR
        self._handlers: dict[str, Callable[[float, str], str | None]] = {
            "OR": self._home,
            "PA": self._move_to,
            "PR": self._move_by,
            "TP": lambda now_s, _: _number(self._position(now_s)),
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
        with self._bench.lock:
            self._advance(self._now())
            return self._state

    def reset(self) -> None:
        """It is switched off and on."""
        with self._bench.lock:
            self._advance(self._now())
            self._reset(self._now())

    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; returns what goes back."""
        *lines, self._tail = (self._tail + data.translate(None, IGNORED)).split(b"\n")
        self._tail = self._tail[-LONGEST_COMMAND:]
        return b"".join(self._line(line) for line in lines)

    def emit(self) -> bytes:
        """Nothing, ever."""
        return b""

    def _line(self, line: bytes) -> bytes:
        if self.fault == "hang":
            return b""
        echo = line + b"\r\n" if self.fault == "echo" else b""
        try:
            reply = self._answer(line.decode("ascii", "replace").upper())
        except _Refused as refusal:
            self._memory, reply = refusal.letter, None
        if reply is None:
            return echo
        body = reply.encode("ascii", "replace")
        return echo + (body.translate(GARBLED) if self.fault == "garbage" else body) + b"\r\n"

    def _answer(self, line: str) -> str | None:
        command = COMMAND_FORM.fullmatch(line)
        if command is None:
            if line:
                raise _Refused("A")
            return None
        address, code, parameter = command.groups()
        to_all = address in {"", "0"} and code == "ST"
        if not to_all and address != str(self._options.axis):
            return None  # another controller's on the same line
        handler = self._handlers.get(code)
        if handler is None:
            raise _Refused("A")
        with self._bench.lock:
            now_s = self._now()
            self._advance(now_s)
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
            raise _Refused(next(letter for states, letter in REFUSALS if self._state in states))

    def _position(self, now_s: float) -> float:
        return float(self._bench.mechanics.encoder_deg(np.array([now_s]))[0])

    def _home(self, now_s: float, _: str) -> None:
        self._only_in(NOT_REFERENCED)
        arrival = self._bench.mechanics.home(
            now_s, self._options.homing_velocity_dps, self._options.acceleration_dps2
        )
        self._state, self._errors, self._setpoint_deg = State.HOMING, 0, 0.0
        self._ahead = (
            _Ahead(arrival.at_s, State.NOT_REFERENCED_FROM_HOMING, FOLLOWING_ERROR | HOMING_TIME_OUT)
            if arrival.stalled
            else _Ahead(arrival.at_s, State.READY_FROM_HOMING)
        )

    def _move_to(self, now_s: float, parameter: str) -> str | None:
        if parameter == "?":
            return _number(self._setpoint_deg)
        self._move(now_s, _parsed(parameter), "N")
        return None

    def _move_by(self, now_s: float, parameter: str) -> str | None:
        if parameter == "?":
            return _number(self._setpoint_deg)
        self._move(now_s, self._setpoint_deg + _parsed(parameter), "G")
        return None

    def _move(self, now_s: float, target_deg: float, out_of_limits: str) -> None:
        self._only_in(READY)
        if not self._parameters["SL"] <= target_deg <= self._parameters["SR"]:
            raise _Refused(out_of_limits)
        if target_deg == self._setpoint_deg:
            return
        arrival = self._bench.mechanics.move(
            now_s, target_deg, self._parameters["VA"], self._parameters["AC"]
        )
        self._state, self._setpoint_deg = State.MOVING, target_deg
        self._ahead = (
            _Ahead(arrival.at_s, State.DISABLE_FROM_MOVING, FOLLOWING_ERROR)
            if arrival.stalled
            else _Ahead(arrival.at_s, State.READY_FROM_MOVING)
        )

    def _halt(self, now_s: float) -> float:
        rest_s = self._bench.mechanics.halt(now_s, self._parameters["AC"])
        self._setpoint_deg = self._position(rest_s)
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
            self._setpoint_deg = self._position(now_s)
        else:
            raise _Refused("C")
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
            raise _Refused("C")
        self._parameters[code] = value
        return None

    def _take_error(self, _now_s: float, _: str) -> str:
        letter, self._memory = self._memory, NO_ERROR
        return letter

    def _error_text(self, letter: str) -> str:
        named = letter.removesuffix("?") or self._memory
        if named not in ERROR_TEXTS:
            raise _Refused("C")
        return f" {ERROR_TEXTS[named]}" if letter.removesuffix("?") else f"{named} {ERROR_TEXTS[named]}"


def _parsed(parameter: str) -> float:
    if not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(E[-+]?\d{1,2})?", parameter):
        raise _Refused("C")
    return float(parameter)


def _number(value: float) -> str:
    text = f"{value:.5f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
