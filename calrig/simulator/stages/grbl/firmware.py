"""The firmware: its main loop, its states, and what it does at a byte that acts at once (main.c, protocol.c).

The main loop is a generator: it yields the instant until which it has nothing to do, and goes on then, or
when a byte has come. What acts at once only sets a flag; the loop looks at the flags where the firmware does.
"""

import math
from collections import deque
from collections.abc import Generator
from typing import Protocol

from calrig.simulator.config import StageOptions
from calrig.simulator.stages.grbl.commands import Commands
from calrig.simulator.stages.grbl.eeprom import HARD_LIMITS, HOMING, IDLE_DELAY, LETTERS, Eeprom
from calrig.simulator.stages.grbl.gcode import ParserState, Refusal
from calrig.simulator.stages.grbl.motion import LAST_STEPS_S, Motion
from calrig.simulator.stages.grbl.reports import (
    HARD_LIMIT,
    RESET_IN_HOMING,
    RESET_IN_MOTION,
    SOFT_LIMIT,
    Counters,
    State,
    Status,
    Words,
)
from calrig.simulator.trajectory import Segment

Run = Generator[float, None, None]
LONGEST_LINE = 79
"""Characters that the line buffer holds, without its end."""
ENDS = b"\r\n"
READ_LINE_S, ANSWER_S = 0.0005, 0.001
"""From the end of a line to its execution, and from there to its answer."""
REPORT_S = 0.002
"""What a report takes; a query in that time gets no report of its own."""
ALARM_S = 0.5
"""For so long it waits after an alarm and hears no reset."""
CLOSING_S = 0.004
"""After which a door that only a byte has opened is found closed."""
ALWAYS_ON_MS = 255
RESET, DOOR, JOG_CANCEL = 0x18, 0x84, 0x85
FLAGS = {ord("?"): "report", ord("~"): "resume", ord("!"): "hold", DOOR: "door", JOG_CANCEL: "cancel"}
FEED_STEPS = {0x91: 10, 0x92: -10, 0x93: 1, 0x94: -1}
RAPID_SHARES = {0x95: 100, 0x96: 50, 0x97: 25}
SPINDLE_STEPS = {0x9A: 10, 0x9B: -10, 0x9C: 1, 0x9D: -1}
FEED_RESET, SPINDLE_RESET = 0x90, 0x99
LEAST_SHARE, MOST_SHARE = 10, 200


BYTE_S = 10 / 115200
MOST_WAITING = 128
MOST_SENDING = 104
"""What the send buffer holds; the firmware waits while it is full."""


class Uart:
    """The serial line, in the controller's time: bytes come and go at its rate (serial.c).

    Attributes:
        waiting: what has come and was not read yet; what comes while it is full is lost.
    """

    def __init__(self) -> None:
        self.waiting: deque[int] = deque()
        self._coming: deque[tuple[float, int]] = deque()
        self._going: deque[tuple[float, bytes]] = deque()
        self._heard_s = self._said_s = 0.0

    def feed(self, at_s: float, data: bytes) -> float:
        """Take bytes from the host; return when the last one will have come."""
        self._heard_s = max(self._heard_s, at_s)
        for byte in data:
            self._heard_s += BYTE_S
            self._coming.append((self._heard_s, byte))
        return self._heard_s

    @property
    def next_s(self) -> float:
        """When the next byte comes; infinite where none is on its way."""
        return self._coming[0][0] if self._coming else math.inf

    def take(self, at_s: float) -> bytes:
        """What has come by now, for the receive interrupt."""
        came = bytearray()
        while self._coming and self._coming[0][0] <= at_s:
            came.append(self._coming.popleft()[1])
        return bytes(came)

    def keep(self, byte: int) -> None:
        """Put a byte among those that wait."""
        if len(self.waiting) < MOST_WAITING:
            self.waiting.append(byte)

    def say(self, at_s: float, data: bytes) -> float:
        """Begin to send; return when there is room in the send buffer again."""
        self._said_s = max(self._said_s, at_s) + len(data) * BYTE_S
        self._going.append((self._said_s, data))
        return self._said_s - MOST_SENDING * BYTE_S

    def said(self, at_s: float) -> bytes:
        """What has gone out by now."""
        gone = bytearray()
        while self._going and self._going[0][0] <= at_s:
            gone += self._going.popleft()[1]
        return bytes(gone)

    @property
    def is_sending(self) -> bool:
        """Whether something is still to go out."""
        return bool(self._going)


class LineBuffer:
    """Keeps of a line what is no blank and no comment, in upper case."""

    def __init__(self, *, is_old: bool) -> None:
        self._is_old = is_old
        self._line, self._comment, self._is_too_long = "", "", False

    def take(self, byte: int) -> bool:
        """Take a byte; returns whether it is one too many of an old firmware, which begins again with it."""
        char = chr(byte)
        if self._comment or self._is_too_long:
            if self._comment == "(" and char == ")":
                self._comment = ""
        elif char in "(;":
            self._comment = char
        elif byte <= ord(" ") or char == "/":
            pass
        elif len(self._line) < LONGEST_LINE:
            self._line += char.upper() if byte < MOST_WAITING else char
        elif self._is_old:
            self._line = ""
            return True
        else:
            self._is_too_long = True
        return False

    def end(self) -> tuple[str, bool]:
        """The line that has ended, and whether it is too long; begins the next one."""
        ended = self._line, self._is_too_long
        self._line, self._comment, self._is_too_long = "", "", False
        return ended


class Motor(Protocol):
    """What the firmware turns."""

    def drive(self, way: list[Segment]) -> bool:
        """Turn along a way; returns whether it is blocked on it."""

    def stop_motor(self, at_s: float) -> None:
        """Stop dead."""

    def to_switch(self, at_s: float, side: float) -> float:
        """Units to the switch that it homes to."""


class Firmware:
    """One chip with its memory, its serial line and its motors.

    Attributes:
        at_s: the time that it lives in.
        state: as a report names it.
        flags: what was asked for at once, acted on at the next look at them.
        alarm: reported then; None where there is none.
        is_aborted: a reset was taken; the main loop ends and begins again.
        closed: axes whose switch is held closed.
    """

    flags: set[str]
    alarm: int | None
    counters: Counters
    shares: list[int]
    parser: ParserState

    def __init__(self, options: StageOptions, index: int, motor: Motor) -> None:
        version = options.firmware or "1.1h"
        self.index = index
        self.motor = motor
        self.is_old = version.startswith("0.")
        self.eeprom = Eeprom(options, index, is_old=self.is_old)
        self.words = Words(version, self.eeprom)
        self.letters = LETTERS[: self.eeprom.n_axes]
        self.closed: set[int] = set()
        self._report_delay_s = options.report_delay_s
        self.at_s = 0.0
        self._now_s = -math.inf
        self._retracted = False
        self.switch_on(0.0, 0.0)

    def switch_on(self, at_s: float, boot_s: float) -> None:
        """Begin as after power-up or a reset line: counts are 0; it hears nothing for `boot_s`."""
        self.uart = Uart()
        self.at_s = at_s
        self._boots_until_s = at_s + boot_s
        self._last_heard: int | None = None
        self.motion = Motion(self.eeprom, self.motor.drive, self.index)
        self.state = State.ALARM if self.eeprom.flag(HOMING) else State.IDLE
        self._frozen_s = -math.inf
        self._begin_anew()
        self._commands = Commands(self)
        self._program = self._main()
        self._wake_s = self._boots_until_s

    def run(self, until_s: float) -> None:
        """Live on until an instant."""
        while True:
            event_s = min(self.uart.next_s, max(self._wake_s, self._frozen_s))
            if event_s > until_s:
                break
            self.at_s = max(self.at_s, event_s)
            came = self.uart.take(self.at_s)
            if self.at_s < self._boots_until_s:
                self._last_heard = came[-1] if came else self._last_heard
                continue
            for byte in came:
                self._interrupt(byte)
            self._wake_s = self.at_s
            if self.at_s >= self._frozen_s:
                self._wake_s = next(self._program)
        self._now_s = max(self._now_s, until_s)

    def change_switch(self, at_s: float, *, closed: bool) -> None:
        """The switch of the turning axis changes; with hard limits on, any change of a pin is an alarm."""
        self.at_s = max(self.at_s, at_s)
        was = self.index in self.closed
        self.closed = {self.index} if closed else set()
        if was == closed or not self.eeprom.flag(HARD_LIMITS) or self.at_s < self._boots_until_s:
            return
        if self.state not in (State.ALARM, State.HOME) and self.alarm is None:
            self.reset_now()
            self.alarm = HARD_LIMIT
            self._wake_s = self.at_s

    # What it says

    def say(self, line: str) -> None:
        """Send a line; the firmware waits while the send buffer is full."""
        room_s = self.uart.say(self.at_s, line.encode("ascii", "replace") + b"\r\n")
        self._frozen_s = max(self._frozen_s, room_s)

    def remark(self, text: str) -> None:
        """Send a message."""
        self.say(self.words.remark(text))

    # What it waits for

    def realtime(self) -> Run:
        """Look at the flags; stay here while a hold, a door or sleep suspends the main loop."""
        yield from self._look()
        while self._suspended and not self.is_aborted:
            if self._hold_done and self.state in (State.DOOR, State.SLEEP):
                if not self._retracted:
                    self._retracted, self._closes_s = True, self.at_s + CLOSING_S
                    self.accessories = 5, 9
                    self.counters.overrides = 0
                    if self.state == State.SLEEP:
                        self.remark("Sleeping")
                elif self.at_s >= self._closes_s:
                    self._ajar = False
            yield self._next_s()
            yield from self._look()

    def synchronise(self) -> Run:
        """Wait until all motion is made."""
        self.cycle_start()
        while True:
            yield from self.realtime()
            if self.is_aborted or (self.motion.is_empty and self.state != State.RUN):
                return
            yield self._next_s()

    def wait_for_room(self) -> Run:
        """Wait until the planner takes another line."""
        while True:
            yield from self.realtime()
            if self.is_aborted or self.motion.room(self.at_s):
                return
            self.cycle_start()
            yield from self._look()
            yield min(self._next_s(), max(self.motion.has_room_at(), self.at_s + 1e-6))

    def delay(self, duration_s: float, *, heeds: bool = False) -> Run:
        """Do nothing for a while, deaf to flags or (`heeds`) acting on them."""
        until_s = self.at_s + duration_s
        while self.at_s < until_s and not (heeds and self.is_aborted):
            yield until_s
            if heeds:
                yield from self.realtime()

    def until_reset_or(self, until_s: float) -> Run:
        """Wait for an instant, or for a reset or a door, deaf to all else (homing)."""
        while self.at_s < until_s and not self.flags & {"reset", "door"}:
            yield until_s

    def idle_delay_s(self) -> float:
        """How long it holds the motors after a motion before it goes on."""
        hold_ms = self.eeprom.values[IDLE_DELAY]
        return 0.0 if hold_ms == ALWAYS_ON_MS else hold_ms / 1000

    # What it does

    def begin_s(self) -> float:
        """Return the instant for a motion that begins now, not sampled yet."""
        return max(self.at_s, self._now_s)

    def cycle_start(self) -> None:
        """Have the lines that wait begun at the next look at the flags."""
        if not self.motion.is_empty:
            self.flags.add("resume")

    def reset_now(self) -> None:
        """Take a reset: motors that move are stopped dead, which is an alarm of its own."""
        if "reset" in self.flags:
            return
        self.flags.add("reset")
        self.accessories = 5, 9
        if self.state in (State.RUN, State.JOG, State.HOME) or self._braking:
            if self.state == State.HOME:
                self.alarm = self.alarm or RESET_IN_HOMING
            else:
                self.alarm = RESET_IN_MOTION
                self._frozen_s = max(self._frozen_s, self.at_s + self.idle_delay_s())
                self.motion.stop(self.begin_s())
            self.motor.stop_motor(self.begin_s())

    def moves(self) -> bool:
        """Whether a motion is under way that a new line joins."""
        return self.state in (State.RUN, State.JOG) and not self._braking

    def brake_to_idle(self) -> Run:
        """Come to rest on the way, permanently (soft limits)."""
        self.motion.brake(self.begin_s())
        self.state, self._braking = State.HOLD, True
        while self.at_s < self._stops_s() and "reset" not in self.flags:
            yield self._stops_s()
        self._braking, self.state = False, State.IDLE

    def _interrupt(self, byte: int) -> None:
        """Take a byte that has come: some act at once, others wait to be read, the rest is dropped."""
        if byte == RESET:
            self.reset_now()
        elif byte in FLAGS and (byte < MOST_WAITING or not self.is_old):
            if byte != JOG_CANCEL or self.state == State.JOG:
                self.flags.add(FLAGS[byte])
        elif byte < MOST_WAITING or self.is_old:
            self.uart.keep(byte)
        else:
            self._override(byte)

    def _override(self, byte: int) -> None:
        feed, rapid, spindle = self.shares
        if byte == FEED_RESET:
            feed = 100
        elif byte == SPINDLE_RESET:
            spindle = 100
        feed += FEED_STEPS.get(byte, 0)
        spindle += SPINDLE_STEPS.get(byte, 0)
        rapid = RAPID_SHARES.get(byte, rapid)
        shares = [_bounded(feed), rapid, _bounded(spindle)]
        if shares == self.shares:
            return
        self.shares, self.counters.overrides = shares, 0
        self.motion.feed_share, self.motion.rapid_share = feed / 100, rapid / 100
        if self.state in (State.RUN, State.JOG) and not self._braking:
            self.motion.begin(self.begin_s())

    def _clear_suspend(self) -> None:
        self._suspended = self._hold_done = self._braking = False
        self._cancelling = self._ajar = False
        self._retracted = False
        self._closes_s = math.inf

    def _next_s(self) -> float:
        """When the motion that is under way ends, or a door is found closed."""
        next_s = math.inf
        if self.state in (State.RUN, State.JOG) or self._braking:
            next_s = self._stops_s()
        if self._suspended and self._retracted and self._ajar:
            next_s = min(next_s, self._closes_s)
        return next_s

    def _stops_s(self) -> float:
        return max(self.motion.stands_s + LAST_STEPS_S + self.idle_delay_s(), -1.0)

    def _look(self) -> Run:
        """Act on alarm and flags, in the firmware's order."""
        if self.alarm is not None:
            yield from self._tell_alarm()
        if "reset" in self.flags:
            self.is_aborted = True
            return
        moves = self.state in (State.RUN, State.JOG) or self._braking
        stopped = moves and self.at_s >= self._stops_s()
        flags, self.flags = self.flags, set()
        if "report" in flags:
            self._report()
            yield from self.delay(REPORT_S)
            self.flags.discard("report")
        if flags & {"hold", "door", "sleep", "cancel"}:
            self._begin_hold(flags)
        if "resume" in flags and not flags & {"hold", "door", "cancel"}:
            self._resume()
        if stopped:
            self._stopped()

    def _tell_alarm(self) -> Run:
        alarm = self.alarm or 0
        self.state = State.ALARM
        self.say(self.words.alarm(alarm))
        yield from self.delay(ALARM_S)
        if alarm in (HARD_LIMIT, SOFT_LIMIT):
            self.remark("Reset to continue")
            self.flags.discard("reset")
            while "reset" not in self.flags:
                yield math.inf
        self.alarm = None

    def _begin_hold(self, flags: set[str]) -> None:
        if self.state in (State.ALARM, State.CHECK):
            if "sleep" in flags and self.state == State.ALARM:
                self._suspended = self._hold_done = self._retracted = True
                self.state = State.SLEEP
                self.remark("Sleeping")
            return
        if self.state in (State.RUN, State.JOG) and not self._cancelling and not self._braking:
            self.motion.brake(self.begin_s())
            self._braking = True
            if self.state == State.JOG and "sleep" not in flags:
                self._cancelling = self._suspended = True
        if self.state == State.IDLE:
            self._suspended = self._hold_done = True
        if "hold" in flags and self.state not in (State.DOOR, State.JOG, State.SLEEP):
            self.state = State.HOLD
        if "door" in flags:
            self.remark("Check Door")
            if not self._cancelling and self.state != State.SLEEP:
                self.state = State.DOOR
            self._suspended = self._ajar = True
        if "sleep" in flags:
            self.state, self._suspended = State.SLEEP, True

    def _resume(self) -> None:
        if self.state == State.DOOR and self._retracted and not self._ajar:
            self.state = State.IDLE
        if self.state == State.IDLE or (self.state == State.HOLD and self._hold_done):
            self._clear_suspend()
            if self.motion.is_empty:
                self.state = State.IDLE
            else:
                self.state = State.RUN
                self.motion.begin(self.begin_s())

    def _stopped(self) -> None:
        """The last step was made."""
        if self.state in (State.HOLD, State.DOOR, State.SLEEP) and not self._cancelling:
            if not self.motion.rest_is_left():
                self.motion.finish()
            self._braking, self._hold_done, self._suspended = False, True, True
            return
        if self._cancelling:
            self.motion.stop(self.begin_s())
            self.parser.position = self.motion.place(self.at_s)
        self.motion.finish()
        ajar = self._ajar
        self._clear_suspend()
        self.state = State.IDLE
        if ajar:
            self.state, self._ajar, self._suspended, self._hold_done = State.DOOR, True, True, True

    def _report(self) -> None:
        moves = self.state in (State.RUN, State.JOG, State.HOLD, State.DOOR)
        substate = None
        if self.state == State.HOLD:
            substate = 0 if self._hold_done else 1
        elif self.state == State.DOOR:
            substate = (1 if self._ajar else 0) if self._retracted else 2
        spindle, coolant = self.accessories
        self.say(
            self.words.status(
                Status(
                    state=self.state,
                    substate=substate,
                    machine=self.motion.place(self.at_s - self._report_delay_s),
                    offset=self.parser.offset,
                    rate=self.motion.rate(self.at_s) * 60 if moves else 0.0,
                    spindle=self.parser.speed * self.shares[2] / 100 if spindle != 5 else 0.0,
                    room=self.motion.room(self.at_s),
                    receive_room=MOST_WAITING - len(self.uart.waiting),
                    closed="".join(self.letters[axis] for axis in sorted(self.closed)),
                    overrides=(self.shares[0], self.shares[1], self.shares[2]),
                    accessories={3: "S", 4: "C"}.get(spindle, "") + ("F" if coolant == 8 else ""),
                ),
                self.counters,
            )
        )

    # The main loop

    def _main(self) -> Run:
        if self.eeprom.is_blank:
            self.say(self.words.error(7))
            for line in self.words.settings():
                self.say(line)
        last_heard = self._last_heard
        while True:
            self._begin_anew()
            if last_heard is not None:
                self._interrupt(last_heard)
                last_heard = None
            yield from self.delay(self.idle_delay_s())
            self.say("")
            self.say(self.words.banner)
            yield from self._loop()

    def _begin_anew(self) -> None:
        """What a reset leaves: the count, and what the EEPROM keeps."""
        self.is_aborted, self.flags, self.alarm = False, set(), None
        self._clear_suspend()
        self.accessories = 5, 9
        self.counters = Counters()
        self.shares = [100, 100, 100]
        self.uart.waiting.clear()
        self.motion.stop(self.begin_s())
        self.motion.feed_share = self.motion.rapid_share = 1.0
        self.parser = ParserState(self.eeprom.n_axes)
        self.parser.system = list(self.eeprom.offsets[0])
        self.parser.position = self.motion.place(self.begin_s())

    def _loop(self) -> Run:
        if self.closed and self.eeprom.flag(HARD_LIMITS) and not self.is_old:
            self.state = State.ALARM
            self.remark("Check Limits")
        if self.state in (State.ALARM, State.SLEEP):
            self.remark("'$H'|'$X' to unlock")
            self.state = State.ALARM
        else:
            self.state = State.IDLE
            yield from self._commands.run_startup()
        buffer = LineBuffer(is_old=self.is_old)
        while True:
            while self.uart.waiting:
                byte = self.uart.waiting.popleft()
                if byte not in ENDS:
                    if buffer.take(byte):
                        self.say(self.words.error(11))
                    continue
                yield from self.realtime()
                if self.is_aborted:
                    return
                yield from self.delay(READ_LINE_S)
                line, is_too_long = buffer.end()
                yield from self._answer(line, is_too_long=is_too_long)
            self.cycle_start()
            yield from self.realtime()
            if self.is_aborted:
                return
            if not self.uart.waiting:
                yield self._next_s()

    def _answer(self, line: str, *, is_too_long: bool) -> Run:
        answer = "ok"
        try:
            if is_too_long:
                raise Refusal(11)
            if line.startswith("$"):
                yield from self._commands.system(line)
            elif line:
                if self.state in (State.ALARM, State.JOG):
                    raise Refusal(9)
                yield from self._commands.g_code(line)
        except Refusal as refusal:
            answer = self.words.error(refusal.number)
        yield from self.delay(ANSWER_S)
        self.say(answer)
        self._commands.after_answer()


def _bounded(share: int) -> int:
    return min(max(share, LEAST_SHARE), MOST_SHARE)
