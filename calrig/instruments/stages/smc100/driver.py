"""Questions to an SMC100 and their answers, each reply held against the question by its prefix.

A query that stayed unanswered may still be answered later; before the same one is asked again a different
query, the fence, is asked and answered: the controller answers in order, so whatever was late has then come.

Newport SMC100 (driver `smc100`): SMC100CC/PP user's manual; addresses 1–31, lines end CR LF.

Nothing on this wire has a checksum. What a flipped bit could turn into another number is asked for until two
answers agree, and after a move was sent the controller is asked back what target it took (`PA?`).
"""

from __future__ import annotations

import re
import threading
from collections import Counter
from typing import Self

from calrig.instruments import standstill
from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.errors import StageError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.stages.lines import LineWire, plain, unanswered
from calrig.instruments.stages.smc100.words import BAUDRATE, ERROR_BITS, ERRORS, STATES
from calrig.instruments.types import StageIdentity, StageStatus

REPLY_TIMEOUT_S = 0.5
ATTEMPTS = 4
FENCES = ("TS", "TP", "VE")
LINE_END = re.compile(rb"\r?\n")
"""Not CR alone: a digit damaged to one would leave a number that looks whole."""
TEXT_FORM = re.compile(r"\s*(\S.*?)\s*")
ANY_REPLY = re.compile(r"\d{1,2}[A-Z]{2}.+")


class Smc100Wire:
    """One controller on a port. One thread asks; any thread may halt.

    Attributes:
        lines: what is written and read.
    """

    def __init__(self, port: Port, axis: int, faults: Counter[str]) -> None:
        self.lines = LineWire(port, faults, LINE_END)
        self._now_s = port.clock.now_s
        self._axis = axis
        self._faults = faults
        self._unanswered: set[str] = set()
        self._asking = threading.RLock()

    def send(self, command: str) -> None:
        """Sends what moves nothing."""
        self.lines.send(self._line(command))

    def send_motion(self, command: str, who: str) -> None:
        """Sends what moves the stage (Halted, naming `who`, where a stop was sent before)."""
        self.lines.send_motion(self._line(command), who)

    def halt(self) -> None:
        """Sends a stop, from any thread; no motion is sent after it."""
        self.lines.halt(self._line("ST"))

    def close(self) -> None:
        """Closes the port; never raises."""
        with self._asking:
            self.lines.close()

    def ask(self, query: str, form: re.Pattern[str], attempts: int = ATTEMPTS) -> re.Match[str] | None:
        """The answer to a query, None where none comes. After a stop it is asked once: a stop goes first."""
        with self._asking:
            for _ in range(1 if self.lines.halted else attempts):
                if query in self._unanswered and not self._pass_fence():
                    continue
                reply = self._ask_once(query, form)
                if reply:
                    return reply
        return None

    def _pass_fence(self) -> bool:
        fence = next((query for query in FENCES if query not in self._unanswered), None)
        if fence and not self._ask_once(fence, TEXT_FORM):
            return False
        self._unanswered.clear()  # without a fence left, each has had its time-out to come in
        return True

    def _ask_once(self, query: str, form: re.Pattern[str]) -> re.Match[str] | None:
        raise_if_cancelled()
        for early in self.lines.old_lines():
            self._drop(early)
        self.send(query)
        deadline_s = self._now_s() + REPLY_TIMEOUT_S
        prefix = f"{self._axis}{query[:2]}"
        while self._now_s() < deadline_s and (line := self.lines.line(deadline_s)) is not None:
            reply = form.fullmatch(line, len(prefix)) if line.startswith(prefix) else None
            if reply:
                return reply
            self._drop(line)
        self._unanswered.add(query)
        self._faults["no_reply"] += 1
        return None

    def _line(self, command: str) -> bytes:
        return f"{self._axis}{command}\r\n".encode("ascii")

    def _drop(self, line: str) -> None:
        self._faults["late_reply" if ANY_REPLY.fullmatch(line) else "unparsed"] += 1


FEW_ATTEMPTS = 2
"""For what not every controller knows."""
NO_ERROR = "@"
PERHAPS_DAMAGED = "ABCN"
"""What a command that was damaged on its way is refused with: unknown, not for it, out of range."""
ENABLE_TIMEOUT_S = 1.0

STATUS_FORM = re.compile(rf"([0-9A-Fa-f]{{4}})(?i:({'|'.join(STATES)}))")
NUMBER_FORM = re.compile(r"\s*([-+]?\d+(?:\.\d*)?(?:[Ee][-+]?\d{1,2})?)")
LETTER_FORM = re.compile(r"\s*([@A-Z])")


class Smc100:
    """One controller on a port, in the stage's own degrees. Opening it moves nothing."""

    def __init__(self, port: Port, axis: int = 1) -> None:
        self.faults: Counter[str] = Counter()
        self._name = f"stage smc100 at address {axis} on {port.name}"
        self._wire = Smc100Wire(port, axis, self.faults)
        self._now_s = port.clock.now_s
        self._tells_target: bool | None = None  # not known before it was asked
        self._mover = standstill.Mover(
            self._name, self.faults, self.position_deg, self._moves, self.halt, self._target_deg
        )

    @classmethod
    def open(cls, url: str, *, axis: int = 1, baudrate: int | None = None) -> Self:
        """Opens the port (PortError); asks nothing yet."""
        return cls(open_port(url, baudrate=baudrate or BAUDRATE, timeout_s=0.02), axis)

    def identify(self) -> StageIdentity:
        """Asks who it is and what it allows, and switches the motor on if it is off (which moves nothing).

        Raises:
            StageError: it does not answer, or stays in DISABLE.
        """
        if self.status().state == "disabled":
            self._enable()
        low, high = self._number("SL?"), self._number("SR?")
        firmware = self._wire.ask("VE", TEXT_FORM, FEW_ATTEMPTS)
        return StageIdentity(
            driver="smc100",
            firmware=firmware[1] if firmware else None,
            limits_deg=None if low is None or high is None else (low, high),
            velocity_dps=self._number("VA?"),
            acceleration_dps2=self._number("AC?"),
        )

    def status(self) -> StageStatus:
        """State and error bits, in words (StageError if it does not answer); what ends a run comes twice."""
        seen = self._look()
        return self._look() if seen.state in ("disabled", "configuration") else seen

    def _look(self) -> StageStatus:
        bits, code = self._must("TS", STATUS_FORM).groups()
        state, words = STATES[code.upper()]
        raised = [text for k, text in enumerate(ERROR_BITS) if int(bits, 16) >> k & 1]
        if state == "disabled" and self._wire.lines.nul_seen:
            raised.append("it sent a NUL byte, as it does when motor power is cut")
        return StageStatus(state, f"{words} ({', '.join(raised)})" if raised else words)

    def position_deg(self) -> float:
        """Where a standing stage says it is: two reads in a row that agree, three on a wire with faults.

        Raises:
            StageError: it does not answer, or stands and yet never says the same twice.
        """
        return standstill.position_deg(self._name, self.glimpse_deg, self._moves, self.faults)

    def glimpse_deg(self) -> float:
        """One read, unchecked: to show a stage on the move, never for a result."""
        return float(self._must("TP", NUMBER_FORM)[1])

    def set_velocity(self, velocity_dps: float) -> None:
        """Sets the velocity of the moves that follow (StageError if refused, or not taken as it was sent)."""
        standstill.velocity(
            self._name,
            velocity_dps,
            lambda: self._command(f"VA{plain(velocity_dps)}"),
            lambda: self._number("VA?"),
        )

    def home(self) -> None:
        """Begins to look for the reference. Sent once: a second `OR` could start a second search.

        Raises:
            StageError: it is not in NOT REFERENCED, the only state that allows it; nothing was sent.
            Halted: it was halted.
        """
        status = self.status()
        if status.state != "not_referenced":
            raise StageError(f"{self._name} homes only from NOT REFERENCED and is in {status.words}")
        self._command("OR", motion=True)

    def move(self, target_deg: float) -> None:
        """Begins a move, and asks back what target the controller took; sent again where it took none.

        Raises:
            StageError: the controller refused it, in its own words, or took it for another and was stopped.
            Halted: it was halted; nothing was sent.
        """
        command = f"PA{plain(target_deg)}"
        self._mover.move(command, target_deg, lambda: self._send(command, motion=True))

    def halt(self) -> None:
        """Stops the stage now, from any thread, waiting for no answer; later motion raises Halted."""
        self._wire.halt()

    def close(self) -> None:
        """Closes the port; never raises."""
        self._wire.close()

    def _enable(self) -> None:
        self._wire.lines.nul_seen = False
        self._command("MM1")
        deadline = self._now_s() + ENABLE_TIMEOUT_S
        while (status := self.status()).state == "disabled":
            if self._now_s() > deadline:
                raise StageError(
                    f"{self._name} stays in {status.words}: is motor power on, and the stage free to turn?"
                )

    def _command(self, command: str, *, motion: bool = False) -> None:
        """Sends what answers nothing, once, and asks whether it was refused."""
        if refusal := self._send(command, motion=motion):
            raise StageError(f"{self._name} refused {command}: {refusal.words}")

    def _send(self, command: str, *, motion: bool) -> standstill.Refusal | None:
        """Sends what answers nothing, and asks whether it was refused."""
        self._must("TE", LETTER_FORM)  # an error of long ago is not this command's
        if motion:
            self._wire.send_motion(command, self._name)
        else:
            self._wire.send(command)
        letter = self._must("TE", LETTER_FORM)[1]
        if letter == NO_ERROR:
            return None
        words = ERRORS.get(letter, "an error this driver does not know")
        return standstill.Refusal(f"{words} (error {letter})", letter in PERHAPS_DAMAGED)

    def _moves(self) -> bool:
        return self.status().state in ("moving", "homing")

    def _target_deg(self) -> float | None:
        """The target it says it has; None where it is one that does not say."""
        if self._tells_target is None:
            self._tells_target = self._wire.ask("PA?", NUMBER_FORM, FEW_ATTEMPTS) is not None
        return float(self._must("PA?", NUMBER_FORM)[1]) if self._tells_target else None

    def _number(self, query: str) -> float | None:
        def ask() -> float | None:
            reply = self._wire.ask(query, NUMBER_FORM, FEW_ATTEMPTS)
            return float(reply[1]) if reply else None

        return standstill.setting(self._name, query, ask)

    def _must(self, query: str, form: re.Pattern[str]) -> re.Match[str]:
        reply = self._wire.ask(query, form)
        if reply is None:
            check = "power, cable, address and baud rate"
            raise StageError(unanswered(self._name, query, self.faults, check))
        return reply
