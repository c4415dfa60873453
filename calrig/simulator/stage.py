"""A stage's controller on a bench, whatever it speaks.

Motion is `mechanics`' business; a dialect says only what its controller says, allows and remembers.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from calrig.simulator.bench import Bench
from calrig.simulator.config import StageFault, StageOptions
from calrig.simulator.mechanics import Arrival

GARBLED = bytes(byte ^ 0x15 for byte in range(256))
"""Digits and letters become others and signs, never the end of a line."""


class Refused(Exception):  # noqa: N818 (an answer of a dialect, caught where it is said or remembered)
    """A command is refused, by a code, a letter or a word of the dialect."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer


class Stage(ABC):
    """A controller with one axis, fed with bytes, answering in bytes.

    Attributes:
        fault: breaks it on purpose, at any time: `hang`, `garbage`, `echo` or None.
    """

    def __init__(self, options: StageOptions, bench: Bench, now: Callable[[], float]) -> None:
        self.fault: StageFault | None = options.fault
        self._options = options
        self._bench = bench
        self._now = now

    @property
    def interval_s(self) -> float | None:
        """Wall time until it may speak unasked; None while it only answers."""
        return None

    @abstractmethod
    def reset(self) -> None:
        """It is switched off and on, or its Arduino is reset."""

    @abstractmethod
    def _advance(self, now_s: float) -> None:
        """Live on until an instant."""

    @contextmanager
    def _at_now(self) -> Iterator[float]:
        """The instant, up to which it has lived on; the bench is this thread's inside the block."""
        with self._bench.lock:
            now_s = self._now()
            self._advance(now_s)
            yield now_s

    @abstractmethod
    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; returns what goes back."""

    def emit(self) -> bytes:
        """What it says unasked: nothing, in most dialects."""
        return b""

    def _search_home(self, now_s: float) -> Arrival:
        options = self._options
        return self._bench.mechanics.home(now_s, options.homing_velocity_dps, options.acceleration_dps2)

    def _encoder_deg(self, at_s: float, age_s: float = 0.0) -> float:
        return float(self._bench.mechanics.encoder_deg(np.array([at_s]), age_s)[0])

    def _reported_deg(self, at_s: float) -> float:
        """What it says of where it is: it says so late."""
        return self._encoder_deg(at_s, self._options.report_delay_s)


class LineStage(Stage):
    """A controller that answers line by line and keeps the beginning of the one that has not ended.

    A subclass defines where a line ends, what the link carries besides lines, and how much of one it keeps.
    """

    line_end = b"\n"
    dropped = b""
    longest_line = 64

    def __init__(self, options: StageOptions, bench: Bench, now: Callable[[], float]) -> None:
        super().__init__(options, bench, now)
        self._tail = b""

    def receive(self, data: bytes) -> bytes:
        """Takes what came over the wire; returns the answers of the lines that it ends."""
        *lines, self._tail = (self._tail + data.translate(None, self.dropped)).split(self.line_end)
        self._tail = self._tail[-self.longest_line :]
        if self.fault == "hang":
            return b""
        return b"".join(
            (line + b"\r\n" if self.fault == "echo" else b"") + self._spoken(self._replies(line))
            for line in lines
        )

    def _spoken(self, replies: list[str]) -> bytes:
        said = [reply.encode("ascii", "replace") for reply in replies]
        if self.fault == "garbage":
            said = [reply.translate(GARBLED) for reply in said]
        return b"".join(reply + b"\r\n" for reply in said)

    @abstractmethod
    def _replies(self, line: bytes) -> list[str]:
        """What it answers to one line, without the ends of lines."""
