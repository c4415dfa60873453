"""Newport ESP301 (driver `esp301`): ESP301 user's manual; axes 1–3, 19200 baud on RS-232, commands end CR.

Its replies are bare numbers that do not say what they answer. So after every query a fence is sent, `VE?` or
`1ID?` in turn, whose text was learned when the controller was first asked: replies come in order, so exactly
one number before the fence is the answer, and none or two are damage, after which the query is asked again.
A damaged digit looks like any other: what matters is accepted when two readbacks agree (`readback`).

Nothing tells whether the stage was homed since power came on. It counts as not referenced until this driver
has homed it, in the way that the stage itself is set up for (`OM`).
"""

from __future__ import annotations

import re
import threading
from collections import Counter
from itertools import cycle
from typing import Self

from calrig.instruments import standstill
from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.errors import StageError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.stages.esp301.words import BAUDRATE, error_words
from calrig.instruments.stages.lines import LineWire, plain, unanswered
from calrig.instruments.types import StageIdentity, StageStatus

REPLY_TIMEOUT_S = 0.5
ATTEMPTS = 4
MOST_ERRORS = 11
"""Ten in its memory, and the 0 after them."""
PERHAPS_DAMAGED = (6, 7, 9, 37, 38)
"""Refusals of a command that may have been damaged on its way."""
PERHAPS_DAMAGED_OF_AXIS = (1, 4, 5, 6, 7)

NUMBER = re.compile(r"\s*([-+]?\d+(?:\.\d*)?(?:[Ee][-+]?\d{1,2})?)\s*")
CODE = re.compile(r"\s*(\d{1,4})\s*")
DONE = re.compile(r"\s*([01])\s*")
NAME = re.compile(r".*[A-Za-z]{2}.*\d.*")


class Esp301:
    """One axis of a controller on a port, in the stage's own degrees. Opening it moves nothing.

    RTS is raised and CTS not waited for: commands are shorter than the controller's memory for them, and a
    stop must not wait.
    """

    def __init__(self, port: Port, axis: int = 1) -> None:
        self.faults: Counter[str] = Counter()
        self._axis = axis
        self._name = f"stage esp301, axis {axis}, on {port.name}"
        self._lines = LineWire(port, self.faults)
        self._now_s = port.clock.now_s
        self._asking = threading.RLock()
        self._fences: dict[str, str] = {}
        self._next_fence = cycle([""])
        self._in_doubt = False
        self._referenced = False
        self._homing = False
        self._fault: int | None = None
        self._tells_target: bool | None = None  # not known before it was asked
        self._mover = standstill.Mover(
            self._name, self.faults, self.position_deg, self._moves, self.halt, self._target_deg
        )

    @classmethod
    def open(cls, url: str, *, axis: int = 1, baudrate: int | None = None) -> Self:
        """Opens the port (PortError); asks nothing yet."""
        return cls(open_port(url, baudrate=baudrate or BAUDRATE, timeout_s=0.02), axis)

    def identify(self) -> StageIdentity:
        """Asks who it is and what it allows (StageError if it does not answer)."""
        with self._asking:
            low, high = self._number("SL?"), self._number("SR?")
            velocity, acceleration = self._number("VA?"), self._number("AC?")
            self._forget_errors()  # of long ago, or of a query that this firmware does not know
            return StageIdentity(
                driver="esp301",
                firmware=self._fences.get("VE?"),
                limits_deg=None if low is None or high is None else (low, high),
                velocity_dps=velocity,
                acceleration_dps2=acceleration,
                homes_each_time=True,
            )

    def status(self) -> StageStatus:
        """Whether it moves and what its error memory holds, in words (StageError if it does not answer)."""
        with self._asking:
            if self._must("MD?", DONE) == "0":
                if self._homing:
                    return StageStatus("homing", "HOMING")
                if self._referenced:
                    return StageStatus("moving", "MOVING")
                return StageStatus("homing", "MOVING, not by calrig")
            self._note_error()
            if self._homing and self._must("MD?", DONE) == "0":
                return StageStatus("homing", "HOMING")  # between two passes of its search it stood
            if self._homing:
                self._homing, self._referenced = False, True
            return self._standing()

    def position_deg(self) -> float:
        """Where a standing stage says it is: two reads in a row that agree, three on a wire with faults.

        Raises:
            StageError: it does not answer, or stands and yet never says the same twice.
        """
        with self._asking:
            return standstill.position_deg(self._name, self.glimpse_deg, self._moves, self.faults)

    def glimpse_deg(self) -> float:
        """One read, unchecked: to show a stage on the move, never for a result."""
        return float(self._must("TP?", NUMBER))

    def set_velocity(self, velocity_dps: float) -> None:
        """Sets the velocity of the moves that follow (StageError if refused, or not taken as it was sent)."""
        standstill.velocity(
            self._name,
            velocity_dps,
            lambda: self._command(f"VA{plain(velocity_dps)}"),
            lambda: self._number("VA?"),
        )

    def home(self) -> None:
        """Switches the motor on and begins to look for the reference; sent once.

        Raises:
            StageError: it moves, or refused, in words.
            Halted: it was halted; nothing was sent.
        """
        with self._asking:
            if self._must("MD?", DONE) == "0":
                raise StageError(f"{self._name} homes only when it stands, and it moves")
            self._lines.refuse_if_halted("OR", self._name)
            self._command("MO")
            self._fault, self._referenced = None, False
            self._command("OR", motion=True)
            self._homing = True

    def move(self, target_deg: float) -> None:
        """Begins a move, and asks back what target the controller took; sent again where it took none.

        Raises:
            StageError: it was not homed, or the controller refused it, or took it for another: stopped.
            Halted: it was halted; nothing was sent.
        """
        with self._asking:
            command = f"PA{plain(target_deg)}"
            self._lines.refuse_if_halted(command, self._name)
            if not self._referenced:
                raise StageError(
                    f"{self._name} was not homed since its port was opened: {command} was not sent"
                )
            self._mover.move(command, target_deg, lambda: self._send(command, motion=True))

    def halt(self) -> None:
        """Stops the stage now, from any thread, waiting for no answer; later motion raises Halted."""
        self._lines.halt(f"{self._axis}ST\r".encode("ascii"))

    def close(self) -> None:
        """Closes the port; never raises."""
        with self._asking:
            self._lines.close()

    def _standing(self) -> StageStatus:
        if self._fault is not None:
            cut = ", and it sent a NUL byte, as when motor power is cut" if self._lines.nul_seen else ""
            return StageStatus("disabled", f"STOPPED: {error_words(self._fault)}{cut}")
        if not self._referenced:
            return StageStatus("not_referenced", "STANDING, not homed since its port was opened")
        return StageStatus("ready", "STANDING")

    def _command(self, command: str, *, motion: bool = False) -> None:
        """Sends what answers nothing, once, and asks whether it was refused."""
        with self._asking:
            if refusal := self._send(command, motion=motion):
                raise StageError(f"{self._name} refused {command}: {refusal.words}")

    def _send(self, command: str, *, motion: bool) -> standstill.Refusal | None:
        self._forget_errors()  # an error of long ago is not this command's
        data = f"{self._axis}{command}\r".encode("ascii")
        if motion:
            self._lines.send_motion(data, self._name)
        else:
            self._lines.send(data)
        code = int(self._must("TE?", CODE))
        if not code:
            return None
        of_axis = code // 100 == self._axis and code % 100 in PERHAPS_DAMAGED_OF_AXIS
        return standstill.Refusal(error_words(code), of_axis or code in PERHAPS_DAMAGED)

    def _moves(self) -> bool:
        return self._must("MD?", DONE) == "0"

    def _target_deg(self) -> float | None:
        """The target it says it has; None where it is one that does not say."""
        if self._tells_target is None:
            self._tells_target = self._ask("PA?", NUMBER) is not None
        return float(self._must("PA?", NUMBER)) if self._tells_target else None

    def _forget_errors(self) -> None:
        for _ in range(MOST_ERRORS):
            if not self._note_error():
                return

    def _note_error(self) -> int:
        """Takes the oldest error from the controller's memory; one of this axis's motion is kept here."""
        code = int(self._must("TE?", CODE))
        in_motion = self._homing or self._referenced
        if in_motion and (code // 100 == self._axis or code in (4, 8)):
            self._fault, self._referenced, self._homing = code, False, False
        return code

    def _number(self, query: str) -> float | None:
        def ask() -> float | None:
            reply = self._ask(query, NUMBER)
            return None if reply is None else float(reply)

        return standstill.setting(self._name, query, ask)

    def _must(self, query: str, form: re.Pattern[str]) -> str:
        reply = self._ask(query, form)
        if reply is None:
            check = "power, cable, axis and baud rate"
            raise StageError(unanswered(self._name, query, self.faults, check))
        return reply

    def _ask(self, query: str, form: re.Pattern[str]) -> str | None:
        with self._asking:
            if not self._fences and not self._learn_fences():
                return None
            sent = query if query == "TE?" else f"{self._axis}{query}"
            for _ in range(1 if self._lines.halted else ATTEMPTS):  # a stop goes first
                reply = self._ask_once(sent, form)
                if reply is not None:
                    return reply
        return None

    def _ask_once(self, sent: str, form: re.Pattern[str]) -> str | None:
        self._catch_up()
        fence = next(self._next_fence)
        self._lines.send(f"{sent}\r".encode("ascii"))
        came = self._listen(1, sent)
        self._lines.send(f"{fence}\r".encode("ascii"))
        came += self._listen(3, sent, fence)
        if not came:
            self.faults["no_reply"] += 1
        if came[-1:] != [self._fences[fence]]:
            self._in_doubt = True
        elif len(came) == 2 and (reply := form.fullmatch(came[0])):
            return reply[1]
        for line in came:
            if line != self._fences[fence]:
                self.faults["late_reply" if NUMBER.fullmatch(line) else "unparsed"] += 1
        return None

    def _listen(self, most: int, *sent: str) -> list[str]:
        """Lines in reply, echoes left out, until `most` came, or a fence's text, or time is up."""
        deadline_s = self._now_s() + REPLY_TIMEOUT_S
        came: list[str] = []
        while len(came) < most and (line := self._lines.line(deadline_s)) is not None:
            if line in sent:
                self.faults["echo"] += 1
            else:
                came.append(line)
            if len(sent) > 1 and line == self._fences[sent[1]]:
                break
        return came

    def _catch_up(self) -> None:
        """Drops what has come, and after an answer that never came, what is still on its way."""
        raise_if_cancelled()
        late = self._lines.old_lines()
        if self._in_doubt:
            deadline_s = self._now_s() + REPLY_TIMEOUT_S
            while (line := self._lines.line(deadline_s)) is not None:
                late.append(line)
            self._in_doubt = False
        if late:
            self.faults["late_reply"] += len(late)

    def _learn_fences(self) -> bool:
        """Asks for the two names until each came twice alike; one of them is enough."""
        for query in ("VE?", f"{self._axis}ID?"):
            last = None
            for attempt in range(ATTEMPTS + 1):
                if self._lines.halted and (self._fences or (attempt and last is None)):
                    break  # a stop goes first
                self._catch_up()
                self._lines.send(f"{query}\r".encode("ascii"))
                came = [line for line in self._listen(1, query) if NAME.fullmatch(line)]
                if came and came[0] == last and last not in self._fences.values():
                    self._fences[query] = last
                    break
                last = came[0] if came else None
                self._in_doubt |= not came
        self._next_fence = cycle(self._fences)
        return bool(self._fences)
