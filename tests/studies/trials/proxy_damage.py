"""What is done to the bytes of a serial line, each kind at a rate or once, drawn from a seed."""

from __future__ import annotations

import random
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

TO_DEVICE, TO_HOST = "to the device", "to calrig"
XOFF, NUL = b"\x13", b"\0"
LINES = re.compile(rb"[^\r\n]*[\r\n]+|[^\r\n]+")
PACKETS = re.compile(rb"[^\0]*\0|[^\0]+")
SHORTEST_DELAY_S, LONGEST_DELAY_S = 0.01, 0.7


class Line(Protocol):
    """What a damage needs of the line it is done to."""

    def deliver(self, direction: str, data: bytes, after_s: float = 0.0) -> None:
        """Hands bytes over after what was handed over before them."""

    def keep_for_later(self, data: bytes) -> None:
        """Holds an answer back until calrig has sent its next command."""

    def note(self, direction: str) -> None:
        """The line was damaged just now."""

    def hang_up(self, back_after_s: float | None, *, under_its_name: bool = True) -> None:
        """The adapter is pulled out, and may come back."""


@dataclass(frozen=True)
class Fault:
    """One way in which a line is damaged.

    Attributes:
        kind: of `RATED` or `ONCE`.
        direction: of the bytes; what happens once happens to the line.
        size: of a rated kind how often, a byte (`flip`, `lose`, `stutter`) or a line or packet (the others);
            of one that happens once how long it lasts, in s.
        from_s: after the first bytes when it begins.
    """

    kind: str
    direction: str
    size: float
    from_s: float


class Damage:
    """Does one fault to a line.

    Args:
        fault: which; None leaves the line as it is.
        packets: whether the device sends packets ended by a zero byte, not lines.
        device: for the kinds that happen to the device: makes it reset (`reset`), hold its values (`freeze`).
        now_s: the line's clock.
    """

    def __init__(
        self,
        fault: Fault | None,
        *,
        packets: bool,
        device: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._fault = fault
        self._pieces = {TO_DEVICE: LINES, TO_HOST: PACKETS if packets else LINES}
        self._device = device
        self._now_s = now_s
        self._begins_s: float | None = None
        self._ends_s = 0.0
        self._stalls_until_s = 0.0

    def piece(self, line: Line, direction: str, data: bytes, chance: random.Random) -> None:
        """Passes on what came in one direction, damaged or not."""
        fault, now_s = self._fault, self._now_s()
        if fault is None:
            line.deliver(direction, data)
            return
        if self._begins_s is None:
            self._begins_s = now_s + fault.from_s
        if now_s < self._begins_s:
            line.deliver(direction, data)
        elif fault.kind in ONCE:
            self._once(line, fault, direction, data, now_s)
        elif fault.kind == "echo":
            self._echo(line, direction, data)
        elif direction != fault.direction:
            line.deliver(direction, data)
        else:
            for piece in self._pieces[direction].findall(data):
                self._rated(line, fault, piece, chance)

    def _rated(self, line: Line, fault: Fault, piece: bytes, chance: random.Random) -> None:
        if fault.kind == "late":
            if chance.random() < fault.size:
                line.note(fault.direction)
                line.keep_for_later(piece)
            else:
                line.deliver(fault.direction, piece)
            return
        parts = RATED[fault.kind](piece, fault.size, chance)
        if parts != [(0.0, piece)]:
            line.note(fault.direction)
        for after_s, part in parts:
            line.deliver(fault.direction, part, after_s)

    def _echo(self, line: Line, direction: str, data: bytes) -> None:
        line.deliver(direction, data)
        if direction == TO_DEVICE:
            line.note(TO_HOST)
            line.deliver(TO_HOST, data)

    def _once(self, line: Line, fault: Fault, direction: str, data: bytes, now_s: float) -> None:
        if not self._ends_s:
            self._ends_s = now_s + fault.size
            self._happens(line, fault)
        over = now_s >= self._ends_s
        if over and fault.kind == "freeze" and self._ends_s < float("inf"):
            self._device("thaw")
            self._ends_s = float("inf")
        if fault.kind == "stall" and direction == fault.direction and not over:
            line.deliver(direction, data, self._ends_s - now_s)
        elif fault.kind != "mute" or direction != fault.direction or over:
            line.deliver(direction, data)

    def _happens(self, line: Line, fault: Fault) -> None:
        line.note(fault.direction)
        if fault.kind in ("reset", "freeze"):
            self._device(fault.kind)
        elif fault.kind == "gone":
            line.hang_up(None)
        elif fault.kind == "returns":
            line.hang_up(fault.size)
        elif fault.kind == "renamed":
            line.hang_up(fault.size, under_its_name=False)


Parts = list[tuple[float, bytes]]


def _bytes(change: Callable[[int, random.Random], bytes]) -> Callable[[bytes, float, random.Random], Parts]:
    """A kind that happens to single bytes."""

    def damaged(piece: bytes, rate: float, chance: random.Random) -> Parts:
        parts = [change(byte, chance) if chance.random() < rate else bytes([byte]) for byte in piece]
        return [(0.0, b"".join(parts))]

    return damaged


def _whole(change: Callable[[bytes, random.Random], Parts]) -> Callable[[bytes, float, random.Random], Parts]:
    """A kind that happens to a line or packet."""
    return lambda piece, rate, chance: change(piece, chance) if chance.random() < rate else [(0.0, piece)]


def _cut(piece: bytes, chance: random.Random) -> Parts:
    at = chance.randrange(len(piece) + 1)
    return [(0.0, piece[:at]), (_delay_s(chance), piece[at:])]


def _delay_s(chance: random.Random) -> float:
    return SHORTEST_DELAY_S * (LONGEST_DELAY_S / SHORTEST_DELAY_S) ** chance.random()


def _strewn(what: Callable[[random.Random], bytes]) -> Callable[[bytes, random.Random], Parts]:
    """Bytes that nobody sent, somewhere in a line or packet."""

    def change(piece: bytes, chance: random.Random) -> Parts:
        at = chance.randrange(len(piece) + 1)
        return [(0.0, piece[:at] + what(chance) + piece[at:])]

    return change


RATED: dict[str, Callable[[bytes, float, random.Random], Parts]] = {
    "flip": _bytes(lambda byte, chance: bytes([byte ^ 1 << chance.randrange(8)])),
    "lose": _bytes(lambda byte, chance: b""),
    "stutter": _bytes(lambda byte, chance: bytes([byte, byte])),
    "lose line": _whole(lambda piece, chance: [(0.0, b"")]),
    "double line": _whole(lambda piece, chance: [(0.0, piece + piece)]),
    "noise": _whole(_strewn(lambda chance: chance.randbytes(chance.randint(1, 8)))),
    "nul": _whole(_strewn(lambda chance: NUL)),
    "xoff": _whole(_strewn(lambda chance: XOFF)),
    "delay": _whole(lambda piece, chance: [(_delay_s(chance), piece)]),
    "cut": _whole(_cut),
}
ONCE = ("stall", "mute", "gone", "returns", "renamed", "reset", "freeze")
