"""Questions to an SMC100 and their answers, each reply held against the question by its prefix.

A query that stayed unanswered may still be answered later; before the same one is asked again a different
query, the fence, is asked and answered: the controller answers in order, so whatever was late has then come.
"""

from __future__ import annotations

import re
import threading
from collections import Counter

from calrig.instruments.ports import Port
from calrig.instruments.stages.lines import LineWire
from calrig.instruments.wanted import require_wanted

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
        require_wanted()
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
