"""A stream of CSV in pieces of whole rows, of any length in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO

from calrig.export.cells import CsvError

PIECE_BYTES = 2_000_000
"""More than the rows that tell how cells are written (`csv_dialect.EXAMINED_BYTES`)."""
LONGEST_BYTES = 8_000_000
"""Of a piece without the end of a row in it."""


def pieces_of(stream: IO[bytes]) -> Iterator[bytes]:
    """Pieces that end where a row does: at the end of a line, outside of quotes.

    Raises:
        CsvError: a row, or what is between two quotes, has no end.
    """
    held, lines = b"", 1
    while more := stream.read(PIECE_BYTES):
        held += more
        end = _end_of_rows(held)
        if end:
            yield held[:end]
            lines += held.count(b"\n", 0, end)
            held = held[end:]
        elif len(held) > LONGEST_BYTES:
            raise CsvError(f"a row from here on is longer than {LONGEST_BYTES} bytes", line=lines)
    if held:
        yield held


def _end_of_rows(held: bytes) -> int:
    """Behind the last line's end that is outside of quotes; 0 without one."""
    end = held.rfind(b"\n") + 1
    quotes = held.count(b'"', 0, end)
    while end and quotes % 2:
        before = held.rfind(b"\n", 0, end - 1) + 1
        quotes -= held.count(b'"', before, end)
        end = before
    return end
