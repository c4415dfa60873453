"""What unmodified firmware said on its serial line: the recordings of ../shared/wire (README there)."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from repository import SHARED

WIRE = Path(os.environ.get("CALRIG_WIRE", SHARED / "wire"))
BOOT_LOADER_S = 1.5
SILENCE_S = 0.05
"""What ends a piece that has no line end."""


class Event(NamedTuple):
    """At t_s after the reset line `way` is `from` the device, `to` it, or an `event` in words."""

    t_s: float
    way: str
    text: str

    @property
    def data(self) -> bytes:
        return self.text.encode("latin-1")

    def says(self, *beginnings: str) -> bool:
        """Whether it came from the device and begins with one of these."""
        return self.way == "from" and self.text.startswith(beginnings)


def recordings(pattern: str) -> list[Any]:
    """The names of recordings, as parameters of a test; one that skips, saying why, where there are none."""
    missing = pytest.param("", marks=pytest.mark.skip(f"no recorded conversations in {WIRE}"))
    return sorted(path.stem for path in WIRE.glob(f"{pattern}.jsonl")) or [missing]


def settings_of(name: str) -> dict[int, float]:
    """What a recorded GRBL listed before the conversation."""
    return {int(number): float(value) for number, value in _rows(name)[0]["settings"].items()}


def recording(name: str) -> list[Event]:
    """A conversation, without the time of lines that were left out of the file."""
    head, *rows = _rows(name)
    events = []
    for row in rows:
        left_out_s = sum(
            cut["to_s"] - cut["from_s"] for cut in head.get("cut", []) if cut["to_s"] <= row["t"]
        )
        way = next(key for key in ("from", "to", "event") if key in row)
        events.append(Event(row["t"] - left_out_s, way, row[way]))
    return events


def _rows(name: str) -> list[dict[str, Any]]:
    path = WIRE / f"{name}.jsonl"
    if not path.is_file():
        pytest.skip(f"the recorded conversation {path.name} is not in {WIRE}")
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def starts(events: list[Event]) -> list[list[Event]]:
    """What came after each reset, in s from the boot loader's end; bytes in flight at the reset left out."""
    resets = [k for k, event in enumerate(events) if event.text == "reset line"]
    return [
        [
            Event(event.t_s - events[first].t_s - BOOT_LOADER_S, event.way, event.text)
            for event in events[first + 1 : last]
            if event.t_s > events[first].t_s + BOOT_LOADER_S
        ]
        for first, last in zip(resets, [*resets[1:], len(events)], strict=True)
    ]


def in_pieces(said: Iterable[tuple[float, str]]) -> list[Event]:
    """What came in time, as a recording has it: a line, or a part of one before a silence."""
    pieces: list[Event] = []
    text, last_s = "", 0.0
    for at_s, came in said:
        for character in came:
            if text and at_s - last_s > SILENCE_S:
                pieces.append(Event(last_s, "from", text))
                text = ""
            text, last_s = text + character, at_s
            if character == "\n":
                pieces.append(Event(last_s, "from", text))
                text = ""
    return pieces
