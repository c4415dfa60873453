"""Lines to and from a stage's controller: whole ones or none, and a stop that nothing can overtake."""

import math
import re
import threading
from collections import Counter

from calrig.instruments.errors import Halted
from calrig.instruments.ports import Port

LONGEST_LINE = 256
MOST_QUOTED = 60
DRAIN_S = 0.5
COMING_S = 0.05
"""A line whose last byte came so lately is still coming: on a socket they are read one by one."""
LINE_END = re.compile(rb"[\r\n]+")
XOFF = b"\x13"
XON_XOFF = b"\x11" + XOFF


class LineWire:
    """One controller's lines; empty ones are dropped.

    One thread asks; any thread may halt. Software flow control is left off: commands are short and go one at
    a time, and a stray XOFF must never be able to hold back a stop; it is counted as `flow_control`.

    Args:
        end: what ends a line; without, CR, LF or both.

    Attributes:
        nul_seen: a NUL byte came, as when motor power is cut.
        halted: a stop was sent; no motion follows it.
    """

    def __init__(self, port: Port, faults: Counter[str], end: re.Pattern[bytes] = LINE_END) -> None:
        self.nul_seen = False
        self.halted = False
        self._port = port
        self._now_s = port.clock.now_s
        self._faults = faults
        self._end = end
        self._tail = b""
        self._came_s = -math.inf
        self._sending = threading.Lock()

    def send(self, data: bytes) -> None:
        """Sends what moves nothing."""
        with self._sending:
            self._port.write(data)

    def send_motion(self, data: bytes, who: str) -> None:
        """Sends what moves the stage (Halted, naming `who`, where a stop was sent before)."""
        with self._sending:
            self.refuse_if_halted(data.decode("ascii").strip(), who)
            self._port.write(data)

    def refuse_if_halted(self, what: str, who: str) -> None:
        """Raises Halted where a stop was sent before."""
        if self.halted:
            raise Halted(f"{who} was halted: {what} was not sent")

    def halt(self, data: bytes) -> None:
        """Sends a stop, from any thread; no motion is sent after it."""
        self.halted = True  # before the lock: whoever holds it for a motion is followed by the stop
        with self._sending:
            self._port.write(data)

    def line(self, deadline_s: float) -> str | None:
        """The next whole line, waiting until `deadline_s` (port's clock); then half a line is dropped."""
        while (line := self._next()) is None:
            if self._now_s() >= deadline_s and not self._is_coming:
                self._drop_tail()
                return None
            self._read()
        return line

    @property
    def _is_coming(self) -> bool:
        return bool(self._tail) and self._now_s() - self._came_s < COMING_S

    def old_lines(self) -> list[str]:
        """What came before anything was asked; half a line is kept for its rest as long as it is coming."""
        deadline_s = self._now_s() + DRAIN_S
        while self._port.waiting() and self._now_s() < deadline_s:
            self._read()
        lines = []
        while (line := self._next()) is not None:
            lines.append(line)
        if not self._is_coming:
            self._drop_tail()
        return lines

    def close(self) -> None:
        """Closes the port; never raises."""
        with self._sending:
            self._port.close()

    def _read(self) -> None:
        data = self._port.read_some()
        if XOFF in data:
            self._faults["flow_control"] += data.count(XOFF)
        data = data.translate(None, XON_XOFF)
        self.nul_seen |= b"\0" in data
        self._tail += data
        if data:
            self._came_s = self._now_s()

    def _next(self) -> str | None:
        while end := self._end.search(self._tail):
            line, self._tail = self._tail[: end.start()], self._tail[end.end() :]
            bare = line.lstrip(b"\0")
            if bare != line:
                self._faults["unparsed"] += 1
            if bare:
                return bare.decode("ascii", "replace")
        if len(self._tail) > LONGEST_LINE:
            self._drop_tail()
        return None

    def _drop_tail(self) -> None:
        if self._tail:
            self._faults["unparsed"] += 1
        self._tail = b""


def plain(value: float) -> str:
    """A number without exponent, to a millionth, as short as it can be written."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def unanswered(name: str, query: str, faults: Counter[str], check: str, said: str | None = None) -> str:
    """Say that a query has no reply, or none that can be read.

    `faults` are counts by kind up to now, `check` is what a person is to look at if nothing answers, `said`
    the last reply to the query that has not the form of one, None if none came.
    """
    counted = ", ".join(f"{count} {kind}" for kind, count in faults.items())
    what = f"does not answer {query}"
    if said is not None:
        what = f"answers {query} with {said[:MOST_QUOTED]!r}, which cannot be read"
        check = "the serial cable and the controller"
    return f"{name} {what} (faults so far: {counted or 'nothing'}): check {check}"
