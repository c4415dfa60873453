"""The stage's dialect: GRBL 1.1 on an Arduino with a stepper shield (gnea/grbl, doc and protocol.c).

It counts steps and never looks at the table: what it loses against an obstruction it does not know. Angles
it allows lie between the options' limits. Opening a pseudo-terminal cannot reset it; `reset` does. Told to be
a `0.9j`, it words its reports, alarms and remarks as that did.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from calrig.simulator.bench import Bench
from calrig.simulator.config import StageOptions
from calrig.simulator.stage import GARBLED, Stage
from calrig.simulator.stages.grbl.modal import Modal
from calrig.simulator.stages.grbl.words import (
    HARD_LIMIT,
    LETTERS,
    NO_SWITCH,
    RESET_IN_HOMING,
    RESET_IN_MOTION,
    SOFT_LIMIT,
    STEPS_PER_DEG,
    State,
    Words,
    settings,
)

LONGEST_LINE = 80
MOST_KEPT = 128
"""Bytes that the Arduino's receive buffer holds while it homes or holds, and reads none."""
REAL_TIME = b"?!~\x18\x85"
WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")


class _Refused(Exception):  # noqa: N818 (a number of the dialect, caught where it is said)
    def __init__(self, number: int) -> None:
        self.number = number


class Grbl(Stage):
    """A controller with one turning axis, fed with bytes, answering in bytes."""

    interval_s = 0.01
    """How often it looks whether homing has ended, which it answers unasked."""

    def __init__(self, options: StageOptions, bench: Bench, now: Callable[[], float]) -> None:
        super().__init__(options, bench, now)
        self._index = min(options.axis, len(LETTERS)) - 1
        self._words = Words(options.firmware or "1.1h")
        self._line = b""
        self._kept = b""
        self._spoken = b""
        self._locked = False
        self._lost_deg = 0.0
        self._losing_deg = 0.0
        self._target_deg = 0.0
        self._ends: tuple[float, State] | None = None
        self._begin()

    @property
    def state(self) -> State:
        """The state it is in now."""
        with self._bench.lock:
            self._advance()
            return self._state

    def reset(self) -> None:
        """The Arduino is reset, as by opening its port: it counts from here, wherever here is."""
        with self._bench.lock:
            now_s = self._now()
            if self._ends:
                self._bench.mechanics.halt(now_s, 1e4)
            self._ends, self._locked, self._line, self._kept = None, False, b"", b""
            self._lost_deg = -self._encoder_deg(now_s)
            self._target_deg = self._losing_deg = 0.0
            self._begin()

    def close_limit_switch(self) -> None:
        """Something closes a limit switch: it stops dead, and says nothing more until it is reset."""
        with self._bench.lock:
            self._advance()
            if self._ends:
                self._bench.mechanics.halt(self._now(), 1e4)
            self._lock_up(HARD_LIMIT)

    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; returns what goes back."""
        if self.fault == "hang":
            return b""
        with self._bench.lock:
            if self.fault == "echo":
                self._spoken += data
            for byte in data:
                self._advance()
                self._hear(bytes([byte]))
        return self.emit()

    def emit(self) -> bytes:
        """What it has to say: answers, and the end of a homing."""
        with self._bench.lock:
            self._advance()
            said, self._spoken = self._spoken, b""
        if self.fault == "garbage":
            return b"\r\n".join(line.translate(GARBLED) for line in said.split(b"\r\n"))
        return b"" if self.fault == "hang" else said

    def _begin(self) -> None:
        self._state = State.ALARM if self._options.homing else State.IDLE
        self._greet()

    def _greet(self) -> None:
        self._say("")
        self._say(self._words.banner)
        if self._state == State.ALARM:
            self._say(self._words.remark("'$H'|'$X' to unlock"))
        self._modal = Modal()

    def _say(self, line: str) -> None:
        self._spoken += line.encode("ascii") + b"\r\n"

    def _hear(self, byte: bytes) -> None:
        if byte in REAL_TIME:
            self._real_time(byte)
        elif self._state in (State.HOME, State.HOLDING, State.HOLD):
            self._kept = (self._kept + byte)[:MOST_KEPT]
        elif byte not in b"\r\n":
            self._line = (self._line + byte)[: LONGEST_LINE + 1]
        else:
            line, self._line = self._line.decode("ascii", "replace"), b""
            if self._locked:
                return
            try:
                self._execute(re.sub("[ /]", "", line).upper())  # it has no block delete: a slash is dropped
            except _Refused as refusal:
                self._say(f"error:{refusal.number}")

    def _real_time(self, byte: bytes) -> None:
        if byte == b"\x18":
            self._soft_reset()
        elif self._locked or self._state == State.HOME:
            return
        elif byte == b"?":
            angles = ["0.000"] * max(3, self._index + 1)
            angles[self._index] = f"{self._counted(self._reported_deg(self._now())):.3f}"
            self._say(self._words.report(self._state, angles))
        elif byte == b"!" and self._state == State.RUN:
            rest_s = self._bench.mechanics.halt(self._now(), self._options.acceleration_dps2)
            self._state, self._ends = State.HOLDING, (rest_s, State.HOLD)
        elif byte == b"!" and self._state == State.IDLE:
            self._state = State.HOLD
        elif byte == b"~" and self._state == State.HOLD:
            self._state = State.IDLE
            self._turn_to(self._target_deg)
            self._hear_kept()

    def _soft_reset(self) -> None:
        alarm = {
            State.RUN: RESET_IN_MOTION,
            State.HOLDING: RESET_IN_MOTION,
            State.HOME: RESET_IN_HOMING,
        }.get(self._state)
        if alarm is not None:
            self._bench.mechanics.halt(self._now(), 1e4)
            self._ends, self._state = None, State.ALARM
            self._say(self._words.alarm(alarm))
        elif self._state == State.HOLD:
            self._state = State.IDLE
        self._locked, self._line, self._kept = False, b"", b""
        self._target_deg = self._count_deg()
        self._greet()

    def _execute(self, line: str) -> None:
        if len(line) > LONGEST_LINE:
            raise _Refused(11)
        if line.startswith("$"):
            self._system(line)
        elif self._state == State.ALARM and line:
            raise _Refused(9)
        else:
            self._g_code(line)
            if not self._locked:
                self._say("ok")

    def _system(self, line: str) -> None:
        if line == "$$":
            if self._state not in (State.IDLE, State.ALARM):
                raise _Refused(8)
            for number, value in settings(self._options, self._index).items():
                self._say(f"${number}={value}")
        elif line == "$I":
            if self._state not in (State.IDLE, State.ALARM):
                raise _Refused(8)
            self._say(self._words.build())
        elif line == "$G":
            self._say(self._words.modes(str(self._modal)))
        elif line == "$X":
            if self._state == State.ALARM:
                self._state = State.IDLE
                self._say(self._words.remark("Caution: Unlocked"))
        elif line == "$H":
            self._home()
            return  # its ok comes at the end
        else:
            raise _Refused(3)
        self._say("ok")

    def _home(self) -> None:
        if not self._options.homing:
            raise _Refused(5)
        if self._state not in (State.IDLE, State.ALARM):
            raise _Refused(8)
        arrival = self._bench.mechanics.home(
            self._now(), self._options.homing_velocity_dps, self._options.acceleration_dps2
        )
        self._state = State.HOME
        self._ends = arrival.at_s, State.ALARM if arrival.stalled else State.IDLE

    def _g_code(self, line: str) -> None:
        words = WORD.findall(line)
        if "".join(letter + number for letter, number in words) != line:
            raise _Refused(2)
        turn = feed = None
        for letter, text in words:
            number = float(text)
            if letter == "F":
                feed = number
            elif letter == LETTERS[self._index]:
                turn = number
            elif not self._modal.take(letter, number):
                raise _Refused(20)
        if feed is not None:
            self._modal.feed_dpm = feed * self._modal.unit_deg
        if turn is not None:
            self._move(turn * self._modal.unit_deg + (0.0 if self._modal.absolute else self._target_deg))

    def _move(self, target_deg: float) -> None:
        if not self._modal.rapid and self._modal.feed_dpm is None:
            raise _Refused(22)
        low, high = self._options.limits_deg
        if self._options.homing and not low <= target_deg <= high:
            self._lock_up(SOFT_LIMIT)
        else:
            self._turn_to(target_deg)

    def _lock_up(self, alarm: int) -> None:
        self._locked, self._state, self._ends = True, State.ALARM, None
        self._say(self._words.alarm(alarm))
        self._say(self._words.remark("Reset to continue"))

    def _turn_to(self, target_deg: float) -> None:
        self._target_deg = round(target_deg * STEPS_PER_DEG) / STEPS_PER_DEG
        now_s = self._now() if self._state != State.RUN or self._ends is None else self._ends[0]
        velocity = self._options.velocity_dps
        if not self._modal.rapid:
            velocity = min((self._modal.feed_dpm or 0.0) / 60, velocity)
        if self._target_deg == self._count_deg(now_s):
            return
        arrival = self._bench.mechanics.move(
            now_s, self._target_deg - self._lost_deg, velocity, self._options.acceleration_dps2
        )
        if arrival.stalled:
            self._losing_deg = self._target_deg - self._encoder_deg(arrival.at_s) - self._lost_deg
        self._state, self._ends = State.RUN, (arrival.at_s, State.IDLE)

    def _advance(self) -> None:
        if self._ends is None or self._now() < self._ends[0]:
            return
        homed = self._state == State.HOME
        (_, self._state), self._ends = self._ends, None
        self._lost_deg, self._losing_deg = self._lost_deg + self._losing_deg, 0.0
        if homed and self._state == State.IDLE:
            self._lost_deg = self._target_deg = 0.0
            self._say("ok")
            self._hear_kept()
        elif homed:
            self._say(self._words.alarm(NO_SWITCH))
            self._greet()

    def _hear_kept(self) -> None:
        kept, self._kept = self._kept, b""
        for byte in kept:
            self._hear(bytes([byte]))

    def _count_deg(self, at_s: float | None = None) -> float:
        return self._counted(self._encoder_deg(self._now() if at_s is None else at_s))

    def _counted(self, encoder_deg: float) -> float:
        return round((encoder_deg + self._lost_deg) * STEPS_PER_DEG) / STEPS_PER_DEG + 0.0


STAGE = Grbl
