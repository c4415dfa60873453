"""Any bytes → a rectangular table of texts with line numbers, or an error that says where; bounded."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from calrig.export.cells import NUMBER, Cells, CsvError

MAX_BYTES = 50_000_000
MAX_COLUMNS = 200
MAX_ROWS = 100_000
MAX_CELLS = 4_000_000
"""Bounds what a file of short cells takes in memory."""
MAX_ROW_CHARACTERS = 1_000_000


@dataclass(frozen=True, slots=True)
class Table:
    """A header and rows of as many cells; lines count from 1, and a row stands in the line it ends in."""

    header: list[str]
    header_line: int
    rows: list[list[str]]
    lines: list[int]

    def column(self, place: int) -> Cells:
        """The cells of one column."""
        return Cells(self.header[place], [row[place] for row in self.rows], self.lines)


def read_table(data: bytes, required: Sequence[str], *, max_rows: int = MAX_ROWS) -> Table:
    """Reads UTF-8 CSV with a header row; BOM, CRLF and blank lines are accepted.

    Raises:
        CsvError: not UTF-8, empty, no rows, a required column missing, a name twice, a ragged row, broken
            quotes, or too large.
    """
    if len(data) > MAX_BYTES:
        raise CsvError(f"the file has {len(data)} bytes; at most {MAX_BYTES} are read")
    rows = _parsed(_decode(data), 1)
    line, names = next(rows, (0, []))
    if not names:
        raise CsvError("the file is empty")
    table = Table(_header(names, line, required), line, [], [])
    _fill(table, rows, max_rows)
    if not table.rows:
        raise CsvError("the file has a header and no rows", line=line)
    return table


def read_header(line_of_names: bytes, line: int) -> list[str]:
    """The column names in a header row that stands in this line, checked as `read_table` does."""
    return _header(next(_parsed(_decode(line_of_names, line), line))[1], line, ())


def read_rows(data: bytes, header: list[str], first_line: int) -> Table:
    """Reads rows under a header read before; the first of them stands in `first_line`."""
    table = Table(header, first_line, [], [])
    _fill(table, _parsed(_decode(data, first_line), first_line), MAX_CELLS)
    return table


def _parsed(text: str, first_line: int) -> Iterator[tuple[int, list[str]]]:
    """Rows that are not blank, each with the line it ends in."""
    lines = _Lines(text, first_line)
    reader = csv.reader(lines, strict=True)
    try:
        for row in reader:
            lines.since_row = 0
            if row:
                yield first_line - 1 + reader.line_num, row
    except csv.Error as error:
        line = first_line - 1 + max(reader.line_num, 1)
        raise CsvError(f"is not CSV ({error})", line=line) from error


def _fill(table: Table, rows: Iterator[tuple[int, list[str]]], max_rows: int) -> None:
    for line, row in rows:
        _check_row(table, row, line, max_rows)
        table.rows.append(row)
        table.lines.append(line)


class _Lines:
    """The text's lines; refuses a row that has grown without end before it is held as a million cells."""

    def __init__(self, text: str, first_line: int) -> None:
        self._lines = io.StringIO(text, newline="")
        self._first_line = first_line
        self.since_row = 0

    def __iter__(self) -> Iterator[str]:
        for number, line in enumerate(self._lines, start=self._first_line):
            self.since_row += len(line)
            if self.since_row > MAX_ROW_CHARACTERS:
                raise CsvError(f"the row is longer than {MAX_ROW_CHARACTERS} characters", line=number)
            yield line


def _decode(data: bytes, first_line: int = 1) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = first_line + data.count(b"\n", 0, error.start)
        raise CsvError(
            f"is not UTF-8 text (byte 0x{data[error.start]:02X}): save the file as UTF-8", line=line
        ) from error


def _header(row: list[str], line: int, required: Sequence[str]) -> list[str]:
    names = [name.strip() for name in row]
    if len(names) > MAX_COLUMNS:
        raise CsvError(f"the header has {len(names)} columns; at most {MAX_COLUMNS} are read", line=line)
    for place, name in enumerate(names):
        if name and name in names[:place]:
            raise CsvError("the header has this name twice", line=line, column=name)
        if len(name) > 100 or not name.isprintable():
            raise CsvError("a name has at most 100 characters, all printable", line=line, column=name)
    for name in required:
        if name not in names:
            raise CsvError(f"there is no such column{_hint(names)}", line=line, column=name)
    return names


def _hint(names: list[str]) -> str:
    if len(names) == 1 and (";" in names[0] or "\t" in names[0]):
        return ": separate cells by `,` and write decimals with `.`"
    if all(NUMBER.fullmatch(name) for name in names):
        return ": the first line holds numbers, and the column names must come before it"
    return ""


def _check_row(table: Table, row: list[str], line: int, max_rows: int) -> None:
    width = len(table.header)
    if len(row) != width:
        hint = " (decimals are written with a point)" if len(row) == 2 * width else ""
        raise CsvError(f"has {len(row)} cells where the header has {width}{hint}", line=line)
    if len(table.rows) >= max_rows:
        raise CsvError(f"the file has more than {max_rows} rows", line=line)
    if width * (len(table.rows) + 1) > MAX_CELLS:
        raise CsvError(f"the file has more than {MAX_CELLS} cells", line=line)
