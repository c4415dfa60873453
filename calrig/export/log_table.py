"""A table of millions of numbers: in pieces by numpy's parser, and cell by cell where that would not do.

numpy takes what it can read, without saying where a bad cell stands, and takes some texts for numbers that
are none. So it is given only pieces of plain numbers; any other piece goes through `calrig.export.csv_table`,
which is forty times slower and exact.
"""

from __future__ import annotations

import io
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.export.cells import LARGEST, CsvError
from calrig.export.csv_table import MAX_BYTES, Table, read_header, read_rows

PIECE_BYTES = 2_000_000
"""As many cells at most, which `csv_table` takes; small beside a log, large beside what a piece costs."""
_PLAIN = b"0123456789+-.eE,\nnaNA"
_SIGNED_NAN = (b"-n", b"-N", b"+n", b"+N")
_BOM = b"\xef\xbb\xbf"


@dataclass(frozen=True, slots=True, eq=False)
class LogTable:
    """The columns of numbers.

    Attributes:
        header: the name of every column.
        header_line: where it stands, from 1.
        columns: (N,) each, by place in the header, those that were asked for; NaN where blank or `nan`.
    """

    header: list[str]
    header_line: int
    columns: dict[int, FloatArray]
    _first_rows: list[int]
    _lines: list[Sequence[int]]

    def line_of(self, row: int) -> int:
        """The line of the file in which a row stands."""
        piece = bisect_right(self._first_rows, row) - 1
        return self._lines[piece][row - self._first_rows[piece]]


def read_log_table(
    data: bytes,
    wanted: Callable[[str], bool],
    *,
    max_rows: int,
    max_bytes: int,
    progress: Callable[[float], None] | None = None,
) -> LogTable:
    """Reads the columns whose names are wanted, as `csv_table.read_table` and `Cells.numbers` would.

    Args:
        data: UTF-8 CSV with a header row.
        wanted: whether a column's cells must be numbers and are kept.
        max_rows: more are refused.
        max_bytes: more are refused.
        progress: told the share that has been read, from 0 to 1.

    Raises:
        CsvError: as they do; says line and column.
    """
    if len(data) > max_bytes:
        raise CsvError(f"the file has {len(data)} bytes; at most {max_bytes} are read")
    header, header_line, body = _header_of(data)
    places = [place for place, name in enumerate(header) if wanted(name)]
    most = data.count(b"\n", body) + data.count(b"\r", body) + 1
    values = np.empty((len(places), min(most, max_rows)))
    n, first_rows, lines = 0, [], []
    for end, piece, first_line in _pieces(data, body, header_line + 1):
        read, at = _numbers(piece, header, first_line, places)
        if n + len(at) > max_rows:
            raise CsvError(f"the file has more than {max_rows} rows", line=at[max_rows - n])
        values[:, n : n + len(at)] = read
        first_rows.append(n)
        lines.append(at)
        n += len(at)
        if progress is not None:
            progress(end / len(data))
    if n == 0:
        raise CsvError("the file has a header and no rows", line=header_line)
    columns = {place: values[k, :n] for k, place in enumerate(places)}
    return LogTable(header, header_line, columns, first_rows, lines)


def _header_of(data: bytes) -> tuple[list[str], int, int]:
    """The names, the line they stand in, and where the rows begin."""
    first = len(_BOM) if data.startswith(_BOM) else 0
    line = 1
    while data[first : first + 1] in (b"\n", b"\r"):
        first += 2 if data.startswith(b"\r\n", first) else 1
        line += 1
    if first >= len(data):
        raise CsvError("the file is empty")
    ends = [end for end in (data.find(b"\n", first), data.find(b"\r", first)) if end >= 0]
    end = min(ends, default=len(data))
    begin = end + (2 if data.startswith(b"\r\n", end) else 1)
    return read_header(data[first:end], line), line, begin


def _pieces(data: bytes, first: int, line: int) -> Iterator[tuple[int, bytes, int]]:
    """Where each piece ends, its whole lines, and the line that it begins with."""
    if b'"' in data or data.count(b"\r") != data.count(b"\r\n"):  # lines may end where no LF is, or not there
        if len(data) > MAX_BYTES:
            raise CsvError(
                f"the file has {len(data)} bytes; at most {MAX_BYTES} are read where cells have quotes or "
                "lines end in CR alone"
            )
        yield len(data), data[first:], line
        return
    while first < len(data):
        end = data.rfind(b"\n", first, first + PIECE_BYTES) + 1 or data.find(b"\n", first) + 1 or len(data)
        piece = data[first:end]
        yield end, piece, line
        first = end
        line += piece.count(b"\n")


def _numbers(
    piece: bytes, header: list[str], first_line: int, places: list[int]
) -> tuple[FloatArray, Sequence[int]]:
    """(columns, rows) numbers of a piece, and the line of each row."""
    plain = _plain(piece, len(header))
    if plain is not None:
        return plain.T[places], range(first_line, first_line + len(plain))
    table: Table = read_rows(piece, header, first_line)
    columns = [table.column(place).numbers() for place in places]
    return np.array(columns, dtype=np.float64).reshape(len(places), len(table.rows)), table.lines


def _plain(piece: bytes, width: int) -> FloatArray | None:
    """(rows, width) numbers, if the piece is nothing but lines of so many plain numbers and blanks."""
    text = piece.replace(b"\r\n", b"\n").removesuffix(b"\n")
    if not text or text.translate(None, _PLAIN) or any(signed in text for signed in _SIGNED_NAN):
        return None
    for _ in range(2):  # of three commas in a row, the middle one is of two pairs
        text = text.replace(b",,", b",nan,")
    text = text.replace(b"\n,", b"\nnan,").replace(b",\n", b",nan\n")
    text = b"nan" * text.startswith(b",") + text + b"nan" * text.endswith(b",")
    try:
        values = np.loadtxt(io.BytesIO(text), delimiter=",", comments=None, ndmin=2, encoding="ascii")
    except ValueError:
        return None
    if values.shape != (text.count(b"\n") + 1, width) or np.nanmax(np.abs(values), initial=0.0) > LARGEST:
        return None
    return values
