"""Newport SMC100 (driver `smc100`): SMC100CC/PP user's manual; addresses 1–31, lines end CR LF.

A query's reply repeats its prefix, so a reply is only ever believed as the answer to what was asked. A query
that stayed unanswered may still be answered later; before the same one is asked again a different query, the
fence, is asked and answered: the controller answers in order, so whatever was late has then come.
"""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from typing import Self

from calrig.instruments.errors import Halted, StageError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.smc100_words import ERROR_BITS, ERRORS, STATES
from calrig.instruments.types import StageIdentity, StageStatus

BAUDRATE = 57600
REPLY_TIMEOUT_S = 0.5
ATTEMPTS = 2
ENABLE_TIMEOUT_S = 1.0
AGREE_DEG = 0.01
LONGEST_LINE = 256
FENCES = ("TS", "TP", "VE")
XON_XOFF = b"\x11\x13"

STATUS_FORM = re.compile(rf"([0-9A-Fa-f]{{4}})(?i:({'|'.join(STATES)}))")
NUMBER_FORM = re.compile(r"\s*([-+]?\d+(?:\.\d*)?(?:[Ee][-+]?\d{1,2})?)")
LETTER_FORM = re.compile(r"\s*([@A-Z])")
TEXT_FORM = re.compile(r"\s*(\S.*?)\s*")
ANY_REPLY = re.compile(r"\d{1,2}[A-Z]{2}.+")


class Smc100:
    """One controller on a port, in the stage's own degrees. Opening it moves nothing.

    Software flow control is left off at this end: commands are short and go one at a time, and a stray XOFF
    must never be able to hold back a stop.
    """

    def __init__(self, port: Port, axis: int = 1) -> None:
        self.faults: Counter[str] = Counter()
        self._port = port
        self._axis = axis
        self._name = f"stage smc100 at address {axis} on {port.name}"
        self._tail = b""
        self._power_was_cut = False
        self._unanswered: set[str] = set()
        self._asking = threading.RLock()
        self._sending = threading.Lock()
        self._halted = False

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
        firmware = self._ask("VE", TEXT_FORM)
        return StageIdentity(
            driver="smc100",
            firmware=firmware[1] if firmware else None,
            limits_deg=None if low is None or high is None else (low, high),
            velocity_dps=self._number("VA?"),
            acceleration_dps2=self._number("AC?"),
        )

    def status(self) -> StageStatus:
        """State and error bits, in words (StageError if it does not answer)."""
        bits, code = self._must("TS", STATUS_FORM).groups()
        state, words = STATES[code.upper()]
        raised = [text for k, text in enumerate(ERROR_BITS) if int(bits, 16) >> k & 1]
        if state == "disabled" and self._power_was_cut:
            raised.append("it sent a NUL byte, as it does when motor power is cut")
        return StageStatus(state, f"{words} ({', '.join(raised)})" if raised else words)

    def position_deg(self) -> float:
        """Where a standing stage says it is: two reads in a row that agree.

        Raises:
            StageError: it does not answer, or stands and yet never says the same twice.
        """
        for _ in range(5):
            first, second = self.glimpse_deg(), self.glimpse_deg()
            if abs(second - first) <= AGREE_DEG or self.status().state in {"moving", "homing"}:
                return second
        raise StageError(
            f"{self._name}: two readings of its position in a row differ ({first:g} and {second:g}) "
            "though it stands: check the encoder and the serial cable"
        )

    def glimpse_deg(self) -> float:
        """One read, unchecked: to show a stage on the move, never for a result."""
        return float(self._must("TP", NUMBER_FORM)[1])

    def set_velocity(self, velocity_dps: float) -> None:
        """Sets the velocity of the moves that follow (StageError if refused)."""
        self._command(f"VA{_plain(velocity_dps)}")

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
        """Begins a move.

        Raises:
            StageError: the controller refused it, in its own words.
            Halted: it was halted; nothing was sent.
        """
        self._command(f"PA{_plain(target_deg)}", motion=True)

    def halt(self) -> None:
        """Stops the stage now, from any thread, waiting for no answer; later motion raises Halted."""
        self._halted = True  # before the lock: whoever holds it for a motion command is followed by the stop
        with self._sending:
            self._write("ST")

    def close(self) -> None:
        """Closes the port; never raises."""
        with self._asking, self._sending:
            self._port.close()

    def _enable(self) -> None:
        self._power_was_cut = False
        self._command("MM1")
        deadline = time.monotonic() + ENABLE_TIMEOUT_S
        while (status := self.status()).state == "disabled":
            if time.monotonic() > deadline:
                raise StageError(
                    f"{self._name} stays in {status.words}: is motor power on, and the stage free to turn?"
                )

    def _command(self, command: str, *, motion: bool = False) -> None:
        """Sends what answers nothing, then asks whether it was refused. Never sent twice."""
        self._must("TE", LETTER_FORM)  # an error of long ago is not this command's
        with self._sending:
            if motion and self._halted:
                raise Halted(f"{self._name} was halted: {command} was not sent")
            self._write(command)
        letter = self._must("TE", LETTER_FORM)[1]
        if letter != "@":
            words = ERRORS.get(letter, "an error this driver does not know")
            raise StageError(f"{self._name} refused {command}: {words} (error {letter})")

    def _number(self, query: str) -> float | None:
        reply = self._ask(query, NUMBER_FORM)
        return float(reply[1]) if reply else None

    def _must(self, query: str, form: re.Pattern[str]) -> re.Match[str]:
        reply = self._ask(query, form)
        if reply is None:
            dropped = ", ".join(f"{count} {kind}" for kind, count in self.faults.items())
            raise StageError(
                f"{self._name} does not answer {query} (dropped so far: {dropped or 'nothing'}): "
                "check power, cable, address and baud rate"
            )
        return reply

    def _ask(self, query: str, form: re.Pattern[str]) -> re.Match[str] | None:
        with self._asking:
            for _ in range(ATTEMPTS):
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
        deadline = time.monotonic() + REPLY_TIMEOUT_S
        while self._port.waiting() and time.monotonic() < deadline:
            self._read()
        while (early := self._next_line()) is not None:
            self._drop(early)
        with self._sending:
            self._write(query)
        deadline = time.monotonic() + REPLY_TIMEOUT_S
        prefix = f"{self._axis}{query[:2]}"
        while time.monotonic() < deadline:
            self._read()
            while (line := self._next_line()) is not None:
                reply = form.fullmatch(line, len(prefix)) if line.startswith(prefix) else None
                if reply:
                    return reply
                self._drop(line)
        self._unanswered.add(query)
        if self._tail:
            self.faults["unparsed"] += 1  # half a line, whose rest would have come by now
            self._tail = b""
        return None

    def _write(self, command: str) -> None:
        self._port.write(f"{self._axis}{command}\r\n".encode("ascii"))

    def _read(self) -> None:
        data = self._port.read_some().translate(None, XON_XOFF)
        self._power_was_cut |= b"\0" in data
        self._tail += data

    def _next_line(self) -> str | None:
        """The next whole line that has come, without NUL bytes before it."""
        line, end, rest = self._tail.partition(b"\n")
        if not end and len(line) <= LONGEST_LINE:
            return None
        self._tail = rest
        if line.startswith(b"\0"):
            self.faults["unparsed"] += 1
        return line.lstrip(b"\0").removesuffix(b"\r").decode("ascii", "replace")

    def _drop(self, line: str) -> None:
        if line:
            self.faults["late_reply" if ANY_REPLY.fullmatch(line) else "unparsed"] += 1


def _plain(value: float) -> str:
    """A number without exponent, to a millionth of a degree, as short as it can be written."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
