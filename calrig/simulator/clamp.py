"""A motorised dividing head that turns the unit in its clamp: `ID`, and `CLAMP 120.000 x`."""

import re
from collections.abc import Callable

from calrig.simulator.bench import Bench
from calrig.simulator.config import ClampOptions

LOOK_S = 0.05
LONGEST_LINE = 64
CLAMP_FORM = re.compile(r"CLAMP ([-+]?\d{1,3}\.\d{3}) (-?[xyz])")


class IndexClamp:
    """Fed with bytes, answering in bytes: `OK` once the unit sits.

    Attributes:
        interval_s: wall time until it may have more to say; None while it only listens.
    """

    driver = "index"

    def __init__(self, options: ClampOptions, bench: Bench, now: Callable[[], float]) -> None:
        self._options = options
        self._bench = bench
        self._now = now
        self._tail = b""
        self._done_s: float | None = None

    @property
    def interval_s(self) -> float | None:
        """Wall time until it may have more to say; None while it only listens."""
        return None if self._done_s is None else LOOK_S

    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; returns the answers that are known at once."""
        *lines, self._tail = (self._tail + data).split(b"\n")
        self._tail = self._tail[-LONGEST_LINE:]
        said = [self._answer(line.decode("ascii", "replace").strip()) for line in lines]
        if self._options.fault == "hang":
            return b""
        return b"".join(f"{answer}\r\n".encode() for answer in said if answer)

    def emit(self) -> bytes:
        """Says so once the unit sits."""
        if self._done_s is None or self._now() < self._done_s:
            return b""
        self._done_s = None
        return b"" if self._options.fault == "hang" else b"OK\r\n"

    def _answer(self, line: str) -> str | None:
        if line == "ID":
            return self._options.firmware
        wanted = CLAMP_FORM.fullmatch(line)
        if wanted is None:
            return f"ERR unknown: {line}" if line else None
        if self._done_s is not None:
            return "ERR it is turning"
        with self._bench.lock:
            self._done_s = self._bench.clamp(self._now(), float(wanted[1]), wanted[2])
        return None
