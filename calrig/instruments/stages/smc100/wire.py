"""Questions to an SMC100 and their answers, each reply held against the question by its prefix.

A query that stayed unanswered may still be answered later; before the same one is asked again a different
query, the fence, is asked and answered: the controller answers in order, so whatever was late has then come.
"""

from __future__ import annotations

import re
import threading
from collections import Counter

from calrig.instruments.errors import Halted
from calrig.instruments.ports import Port

REPLY_TIMEOUT_S = 0.5
ATTEMPTS = 4
LONGEST_LINE = 256
FENCES = ("TS", "TP", "VE")
XOFF = b"\x13"
XON_XOFF = b"\x11" + XOFF
TEXT_FORM = re.compile(r"\s*(\S.*?)\s*")
ANY_REPLY = re.compile(r"\d{1,2}[A-Z]{2}.+")


class Smc100Wire:
    """One controller on a port. One thread asks; any thread may halt.

    Software flow control is left off at this end: commands are short and go one at a time, and a stray XOFF
    must never be able to hold back a stop.

    Attributes:
        nul_seen: a NUL byte came, as when motor power is cut.
    """

    def __init__(self, port: Port, axis: int, faults: Counter[str]) -> None:
        self.nul_seen = False
        self._port = port
        self._now_s = port.clock.now_s
        self._axis = axis
        self._faults = faults
        self._tail = b""
        self._unanswered: set[str] = set()
        self._asking = threading.RLock()
        self._sending = threading.Lock()
        self._halted = False

    def send(self, command: str) -> None:
        """Sends what moves nothing."""
        with self._sending:
            self._write(command)

    def send_motion(self, command: str, who: str) -> None:
        """Sends what moves the stage (Halted, naming `who`, where a stop was sent before)."""
        with self._sending:
            if self._halted:
                raise Halted(f"{who} was halted: {command} was not sent")
            self._write(command)

    def halt(self) -> None:
        """Sends a stop, from any thread; no motion is sent after it."""
        self._halted = True  # before the lock: whoever holds it for a motion command is followed by the stop
        with self._sending:
            self._write("ST")

    def close(self) -> None:
        """Closes the port; never raises."""
        with self._asking, self._sending:
            self._port.close()

    def ask(self, query: str, form: re.Pattern[str], attempts: int = ATTEMPTS) -> re.Match[str] | None:
        """The answer to a query, None where none comes. After a stop it is asked once: a stop goes first."""
        with self._asking:
            for _ in range(1 if self._halted else attempts):
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
        deadline = self._now_s() + REPLY_TIMEOUT_S
        while self._port.waiting() and self._now_s() < deadline:
            self._read()
        while (early := self._next_line()) is not None:
            self._drop(early)
        self.send(query)
        deadline = self._now_s() + REPLY_TIMEOUT_S
        prefix = f"{self._axis}{query[:2]}"
        while self._now_s() < deadline:
            self._read()
            while (line := self._next_line()) is not None:
                reply = form.fullmatch(line, len(prefix)) if line.startswith(prefix) else None
                if reply:
                    return reply
                self._drop(line)
        self._unanswered.add(query)
        self._faults["no_reply"] += 1
        if self._tail:
            self._faults["unparsed"] += 1  # half a line, whose rest would have come by now
            self._tail = b""
        return None

    def _write(self, command: str) -> None:
        self._port.write(f"{self._axis}{command}\r\n".encode("ascii"))

    def _read(self) -> None:
        data = self._port.read_some()
        if XOFF in data:
            self._faults["flow_control"] += data.count(XOFF)
        data = data.translate(None, XON_XOFF)
        self.nul_seen |= b"\0" in data
        self._tail += data

    def _next_line(self) -> str | None:
        """The next whole line that has come, without NUL bytes before it."""
        line, end, rest = self._tail.partition(b"\n")
        if not end and len(line) <= LONGEST_LINE:
            return None
        self._tail = rest
        if line.startswith(b"\0"):
            self._faults["unparsed"] += 1
        return line.lstrip(b"\0").removesuffix(b"\r").decode("ascii", "replace")

    def _drop(self, line: str) -> None:
        if line:
            self._faults["late_reply" if ANY_REPLY.fullmatch(line) else "unparsed"] += 1
