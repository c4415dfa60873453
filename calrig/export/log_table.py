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
from calrig.export.csv_dialect import COMMAS, EXAMINED_BYTES, Dialect, dialect_of
from calrig.export.csv_table import MAX_ROW_CHARACTERS, read_header, read_rows

PIECE_BYTES = 2_000_000
"""Small beside a log, large beside what a piece costs."""
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
    """Reads the columns whose names are wanted, as `csv_table.read_tables` and `Cells.numbers` would.

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
    header, header_line, body, dialect = header_of(data, wanted)
    places = [place for place, name in enumerate(header) if wanted(name)]
    most = data.count(b"\n", body) + data.count(b"\r", body) + 1
    most = min(most, max_rows, (len(data) - body) // len(header) + 1)  # a cell takes a byte with its comma
    values = np.empty((len(places), most))
    n, first_rows, lines = 0, [], []
    for end, read, at in _read(data, body, header, header_line + 1, places, dialect):
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


def header_of(data: bytes, wanted: Callable[[str], bool]) -> tuple[list[str], int, int, Dialect]:
    """The names, the line they stand in, where the rows begin, and how cells are written.

    Args:
        data: from the file's beginning, a megabyte of rows or all of them.
        wanted: whether a column's name is one of those looked for.

    Raises:
        CsvError: it is empty, or no header.
    """
    first = len(_BOM) if data.startswith(_BOM) else 0
    line = 1
    while data[first : first + 1] in (b"\n", b"\r"):
        first += 2 if data.startswith(b"\r\n", first) else 1
        line += 1
    if first >= len(data):
        raise CsvError("the file is empty")
    ends = [end for end in (data.find(b"\n", first), data.find(b"\r", first)) if end >= 0]
    end = min(ends, default=len(data))
    if end - first > 4 * MAX_ROW_CHARACTERS:  # as bytes of UTF-8; to take it apart would cost many seconds
        raise CsvError(f"the row is longer than {MAX_ROW_CHARACTERS} characters", line=line)
    begin = end + (2 if data.startswith(b"\r\n", end) else 1)
    names, rows = data[first:end], data[begin : begin + EXAMINED_BYTES]
    dialect = dialect_of(names.decode(errors="replace"), rows, wanted)
    return read_header(names, line, dialect), line, begin, dialect


Read = tuple[int, FloatArray, Sequence[int]]
"""Where it ends in the file, its (columns, rows) numbers, and the line of each row."""


def _read(
    data: bytes, first: int, header: list[str], line: int, places: list[int], dialect: Dialect
) -> Iterator[Read]:
    """The rows from byte `first` on, which begins this line."""
    if b'"' in data or data.count(b"\r") != data.count(b"\r\n"):  # lines may end where no LF is, or not there
        yield from _read_exactly(data, first, header, line, places, dialect)
        return
    while first < len(data):
        end = data.rfind(b"\n", first, first + PIECE_BYTES) + 1 or data.find(b"\n", first) + 1 or len(data)
        if end - first > max(PIECE_BYTES, 4 * MAX_ROW_CHARACTERS):  # as bytes of UTF-8
            raise CsvError(f"the row is longer than {MAX_ROW_CHARACTERS} characters", line=line)
        piece = data[first:end]
        plain = _plain(piece, len(header), dialect)
        if plain is not None:
            yield end, plain.T[places], range(line, line + len(plain))
        else:
            for _, read, at in _read_exactly(piece, 0, header, line, places, dialect):
                yield end, read, at
        first = end
        line += piece.count(b"\n")


def _read_exactly(
    data: bytes, first: int, header: list[str], line: int, places: list[int], dialect: Dialect
) -> Iterator[Read]:
    for table in read_rows(data, first, header, line, dialect):
        numbers = [table.column(place).numbers() for place in places]
        read = np.array(numbers, dtype=np.float64).reshape(len(places), len(table.rows))
        yield len(data), read, table.lines


def _plain(piece: bytes, width: int, dialect: Dialect) -> FloatArray | None:
    """(rows, width) numbers, if the piece is nothing but lines of so many plain numbers and blanks."""
    if dialect != COMMAS:
        if (b"," if dialect.decimal == "." else b".") in piece:
            return None
        piece = piece.replace(b",", b".").replace(dialect.separator.encode(), b",")
    text = piece.replace(b"\r\n", b"\n").removesuffix(b"\n")
    if not text.strip(b"\n") or text.translate(None, _PLAIN) or any(sign in text for sign in _SIGNED_NAN):
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
