"""Bytes of a board that prints text to whole records of its sketch, and to what else it says."""

from __future__ import annotations

import re
from collections import Counter, deque

from calrig.instruments.boards.sketch import Sketch
from calrig.instruments.errors import BoardError

LONGEST_LINE = 256
STRANGE_KEPT = 20
Record = tuple[float, ...]


class SketchReader:
    """Takes bytes as they come, cut anywhere, and gives the records that are whole.

    A record enters only if each of its lines has the sketch's form to the character, ends CR LF, follows the
    line before, and no number is beyond its bounds. A line that is neither that nor something the sketch
    says is dropped and counted as `unparsed`, once a record has come: before, it may be half a line or a
    banner.

    Args:
        sketch: what the board is said to run.
        faults: counts by kind; a remark of the board's is `board_error`.

    Attributes:
        last_words: what it last said of trouble.
        strange: the last lines since a record that are none of the sketch's.
    """

    def __init__(self, sketch: Sketch, faults: Counter[str]) -> None:
        self.last_words = ""
        self._sketch = sketch
        self._faults = faults
        self._tail = b""
        self._numbers: list[float] = []
        self._place = 0  # of the line awaited in its record
        self._in_stream = False
        self.strange: deque[str] = deque(maxlen=STRANGE_KEPT)
        self._since_record = Counter[str]()

    def feed(self, data: bytes) -> list[Record | None]:
        """The records completed by `data`, None where the board began anew between them.

        Raises:
            BoardError: it says that it stops, and why.
        """
        self._since_record["bytes"] += len(data)
        self._since_record["no text"] += sum(byte > 0x7E or byte < 0x09 for byte in data)
        *lines, self._tail = (self._tail + data).split(b"\n")
        found: list[Record | None] = []
        for line in lines:
            if len(line) <= LONGEST_LINE:
                self._take(line.decode("latin-1"), found)
            else:
                self._drop("")
        self._heed_last_words(self._tail.decode("latin-1"))
        if len(self._tail) > LONGEST_LINE:
            self._tail = b""
            self._drop("")
        return found

    def begin_anew(self) -> bool:
        """Drop half a line, in which a reset made the board fall silent; return whether a record had come."""
        if self._tail or self._place:
            self._drop(self._tail.decode("latin-1"))
        self._tail, was_in_stream, self._in_stream = b"", self._in_stream, False
        return was_in_stream

    @property
    def n_strange(self) -> int:
        """How many bytes have come since the last record."""
        return self._since_record["bytes"]

    @property
    def garbled(self) -> bool:
        """Whether what came since the last record is no text."""
        return self._since_record["no text"] * 10 > self._since_record["bytes"]

    def _take(self, line: str, found: list[Record | None]) -> None:
        text = line.removesuffix("\r")
        whole = text != line
        self._heed_last_words(text)
        if whole and self._continues(text):
            if self._place == len(self._sketch.lines):
                found.append(tuple(self._numbers))
                self._begin_record()
                self._in_stream = True
                self.strange.clear()
                self._since_record.clear()
        elif _says(self._sketch.banner, text):
            if self._in_stream:
                found.append(None)
            self._begin_record()
            self._in_stream = False
        elif _says(self._sketch.remarks, text):
            self.last_words = text.strip()
            self._faults["board_error"] += 1
        elif text or self._place:
            self._drop(text)
            if whole:
                self._continues(text)  # as the first of a record, where the one before was cut short

    def _continues(self, text: str) -> bool:
        """Whether the line is the one that comes next; its numbers are kept."""
        matched = self._sketch.lines[self._place].fullmatch(text)
        if matched is None:
            return False
        numbers = [float(number) for number in matched.groups()]
        bounds = self._sketch.bounds[len(self._numbers) :]
        if any(abs(number) > bound for number, bound in zip(numbers, bounds, strict=False)):
            return False
        self._numbers += numbers
        self._place += 1
        return True

    def _drop(self, text: str) -> None:
        self._begin_record()
        if text:
            self.strange.append(text)
        if self._in_stream:
            self._faults["unparsed"] += 1

    def _begin_record(self) -> None:
        self._numbers, self._place = [], 0

    def _heed_last_words(self, text: str) -> None:
        said = self._sketch.stops and self._sketch.stops.search(text)
        if said:
            raise BoardError(
                f"the board says {said[0]!r} and stops: its sensor does not answer, or is a clone whose "
                "WHO_AM_I is not 0x68; check the sensor's wires and chip, then reset the board"
            )


def _says(pattern: re.Pattern[str] | None, text: str) -> bool:
    return pattern is not None and pattern.search(text) is not None
