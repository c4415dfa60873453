"""Any bytes as rectangular tables of text cells with line numbers, in bounded memory; errors say where.

Separator and decimal sign are detected: comma and point, or the semicolon and comma of other spreadsheets.
Comments, a row of units and units in cells are read, and the report says so.
"""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import re
from array import array
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from calrig.export.csv_cells import ERROR, NOT_AVAILABLE, UNKNOWN, WITH_UNIT, Cells, from_spreadsheet, time_of
from calrig.export.csv_columns import (
    CLOCK_NAMES,
    MAX_COLUMNS,
    MAX_NAME_CHARACTERS,
    SAVE_WITH,
    Column,
    are_data,
    clock_name,
    columns_of,
    header_notes,
    missing_columns,
    own_decimal,
    refuse_bad_names,
    why_no_names,
)
from calrig.export.csv_dialect import (
    COMMAS,
    EXAMINED_BYTES,
    SEPARATORS,
    Dialect,
    dialect_of,
    has_known,
    name_of_last,
    stated_separator,
)
from calrig.export.csv_errors import CsvError, CsvReport, shortened
from calrig.export.csv_units import unit_of_text

MAX_BYTES = 150_000_000
_NOT_AVAILABLE_BYTES = tuple(text.encode() for text in NOT_AVAILABLE)
_NAME_ENDS = re.compile(rb"[,;\t]")
MAX_ROWS = 100_000
MAX_CELLS = 2_000_000
"""Bounds what a file of short cells takes in memory."""
MAX_ROW_CHARACTERS = 1_000_000
BATCH_CELLS = 50_000
"""Held as texts at once, which take ten times the memory of numbers."""
TOLD_LINES = 1000
"""The progress is reported every so many lines."""


@dataclass(frozen=True, slots=True)
class Layout:
    """How a file is written.

    Attributes:
        header_line: the line of the header, from 1.
        begin: the byte at which the rows begin.
        first_line: the line that begins there.
        units: the cells of the row of units, None without one.
    """

    columns: list[Column]
    header_line: int
    begin: int
    first_line: int
    dialect: Dialect = COMMAS
    units: Sequence[str] | None = None
    report: CsvReport = field(default_factory=CsvReport)

    @property
    def header(self) -> list[str]:
        """The names that the columns are read as."""
        return [column.name for column in self.columns]

    @property
    def texts(self) -> list[str]:
        """What the header calls the columns."""
        return [column.text for column in self.columns]

    def is_comment(self, line: str) -> bool:
        """Return whether a line that begins with `#` is a comment, and no row with `#N/A` or a text first."""
        cells = line.strip().split(self.dialect.separator)
        first = cells[0].strip()
        if not first.startswith("#") or first.lower() in NOT_AVAILABLE or ERROR.fullmatch(first):
            return False
        return len(cells) != len(self.columns) or not self.columns[0].is_text


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of as many cells as the header has; lines count from 1, and a row's line is the one it ends in."""

    layout: Layout
    rows: list[list[str]]
    lines: Sequence[int]

    def column(self, place: int) -> Cells:
        """Return the cells of one column."""
        column, texts = self.layout.columns[place], [row[place] for row in self.rows]
        return Cells(column, texts, self.lines, column.decimal or self.layout.dialect.decimal)


def read_tables(
    data: bytes,
    known: Collection[str],
    required: Sequence[str] = (),
    *,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Table]:
    """Read UTF-8 CSV with a header row; BOM, CRLF and blank lines are accepted.

    Cells are separated by commas, or by semicolons or tabs, which allow of decimal commas (`layout_of`). All
    faults, those that a consumer adds to the layout's report as well, are raised together at the end.

    `known` are names that have a meaning here, `required` those of them that the file must have; `progress`
    gets the share that is read, 0 to 1.

    Yields:
        The rows in the order of the file, some at a time, each time under the same header.

    Raises:
        CsvError: not UTF-8, empty, no rows, a required column missing, a name twice, a ragged row, broken
            quotes, or too large.
    """
    if len(data) > MAX_BYTES:
        raise CsvError(f"the file has {len(data)} bytes; at most {MAX_BYTES} are read")
    layout = layout_of(data, known, required)
    width, n = len(layout.columns), 0
    with layout.report as report:
        for table in read_rows(data, layout, layout.begin, layout.first_line, progress):
            n += len(table.rows)
            if n > MAX_ROWS:
                at = table.lines[len(table.rows) - (n - MAX_ROWS)]
                raise CsvError(f"the file has more than {MAX_ROWS} rows", line=at)
            if n * width > MAX_CELLS:
                at = table.lines[MAX_CELLS // width - (n - len(table.rows))]
                raise CsvError(f"the file has more than {MAX_CELLS} cells", line=at)
            yield table
        if n == 0 and not report.has_faults:
            raise CsvError("the file has a header and no rows", line=layout.header_line)


def layout_of(data: bytes, known: Collection[str], required: Sequence[str] = ()) -> Layout:
    """Return how a file is written.

    The header is the first line that is neither blank nor a comment; or the comment before it, if only that
    has known names; or a line further down, if only that has the required, or known, ones. A line such as
    `sep=;` may come before it, a row of units after it.

    `data` has the file's beginning, a megabyte of rows or all of them; `required` are those of the `known`
    names that the file must have.

    Raises:
        CsvError: it is empty, or no header, or lacks columns; says all that it lacks.
    """
    report = CsvReport()
    row = _next_row(data, len(codecs.BOM_UTF8) if data.startswith(codecs.BOM_UTF8) else 0, 1)
    separators = SEPARATORS
    if stated := stated_separator(row.text, row.line):
        separators = (stated,)
        report.say(f"line {row.line} is read as the separator of the cells")
        row = _next_row(data, row.end, row.line + 1)
    header = _header_elsewhere(data, row, known, required) or row
    if header.line < row.line:
        report.say(f"the names of the columns are read from the comment in line {header.line}")
    elif header.line > row.line:
        report.say(f"what comes before the names of the columns, in line {header.line}, is not read")
    if not header.text:
        raise CsvError("the file has comments and no rows" if row.comments else "the file is empty")
    if what := next((what for begin, what in _NO_TABLES.items() if begin.match(header.text)), None):
        raise CsvError(f"is {what}", line=header.line)
    rows = data[header.end : header.end + EXAMINED_BYTES]
    if _has_long_names(header):
        raise CsvError(why_no_names([header.text.decode(errors="replace")]), line=header.line)
    dialect = dialect_of(header.text, rows, known, separators)
    texts = [from_spreadsheet(name.strip()) for name in _cells(header, dialect)]
    texts += name_of_last(rows, dialect, len(texts), report)
    if len(texts) > MAX_COLUMNS:
        raise CsvError(f"has {len(texts)} columns; at most {MAX_COLUMNS} are read", line=header.line)
    begin, first_line, units = header.end, header.line + 1, None
    second = _next_row(data, begin, first_line)
    if _is_of_units(second, dialect, len(texts)):
        begin, first_line, units = second.end, second.line + 1, _cells(second, dialect)
        report.say(f"line {second.line} is read as a row of units")
    for comment in (*row.comments, *(second.comments if units else ())):
        if comment.line != header.line:
            report.count(COMMENTS, f"line {comment.line}")
    columns = columns_of(texts, units, known, required, header.line)
    _read_by_cells(columns, data[begin : begin + EXAMINED_BYTES // 10], dialect, known, required)
    refuse_bad_names(columns, header.line)
    with report:
        below = None if {*required} <= {c.name for c in columns} else _names_below(data, header, dialect)
        for fault in missing_columns(columns, required, header.line, below=below):
            report.add_fault(fault)
    for note in header_notes(columns, known):
        report.say(note)
    return Layout(columns, header.line, begin, first_line, dialect, units, report)


def _has_long_names(row: _Row) -> bool:
    """Whether a line has names that would take long to compare."""
    return any(len(name) > 4 * MAX_NAME_CHARACTERS for name in _NAME_ENDS.split(row.text))


class _Row(NamedTuple):
    """A line: its text without its end, its number, where it begins and ends, and the comments before it."""

    text: bytes
    line: int
    begin: int
    end: int
    comments: tuple[_Row, ...] = ()


PREAMBLE_ROWS, PREAMBLE_BYTES = 100, 100_000
"""How far down the names of the columns are looked for."""


def _header_elsewhere(
    data: bytes, first: _Row, known: Collection[str], required: Sequence[str]
) -> _Row | None:
    """The comment before a row without a known name, or the row below with all required, or known, names."""
    if _has_long_names(first) or has_known(first.text, known):
        return None
    if first.comments:
        bare = first.comments[-1]._replace(text=first.comments[-1].text.lstrip(b" #"))
        if not _has_long_names(bare) and has_known(bare.text, known):
            return bare
    wanted = [[name] for name in required] or [[*known]]
    for row in _rows_below(data, first):
        if not _has_long_names(row) and all(has_known(row.text, names) for names in wanted):
            return row
    return None


def _rows_below(data: bytes, row: _Row) -> Iterator[_Row]:
    """The next rows, as far as names are looked for."""
    near = data[: row.end + PREAMBLE_BYTES]
    for _ in range(PREAMBLE_ROWS):
        row = _next_row(near, row.end, row.line + 1)
        yield row


def _names_below(data: bytes, header: _Row, dialect: Dialect) -> int | None:
    """The first of the lines right above most data that have as many cells, if the header has fewer."""
    rows = [header, *_rows_below(data, header)]
    texts = (row.text.decode(errors="replace").rstrip(dialect.separator) for row in rows)
    cells = [text.split(dialect.separator) for text in texts]
    kinds = "".join("d" if len(own) > 1 and are_data(own) else " " for own in cells)
    k = kinds.index(max(kinds.split(), key=len, default=""))  # a list of channels may look like a few data
    while k > 1 and len(cells[k - 1]) == len(cells[k]):
        if not are_data(cells[k]) and rows[k - 1].line + 1 < rows[k].line:
            break  # lines of another kind, above a blank one
        k -= 1
    return rows[k].line if len(cells[k]) > len(cells[0]) and not are_data(cells[k]) else None


_JSON = re.compile(rb"""\s*(\{|\[\s*([\[{"\d-]|\Z))""")
_NO_TABLES = {
    _JSON: "JSON, not a table: write the names of the columns, then a row each",
    re.compile(rb"PK\x03\x04|\xD0\xCF\x11\xE0"): "a workbook or an archive, not text: save the table as CSV",
    re.compile(rb"MATLAB \d|\x89HDF"): "a file of MATLAB or HDF5, not text: save the table as CSV",
}
_LINE = re.compile(rb"([^\r\n]*)(?:\r\n|\r|\n|\Z)")


def _next_row(data: bytes, begin: int, line: int) -> _Row:
    """The next line that is neither blank nor a comment; without text at the end of the data."""
    comments: list[_Row] = []
    while begin < len(data) and (found := _LINE.match(data, begin)) is not None:
        text = found[1]
        if len(text) > 4 * MAX_ROW_CHARACTERS:  # as bytes of UTF-8; to take it apart would cost many seconds
            raise CsvError(f"the row is longer than {MAX_ROW_CHARACTERS} characters", line=line)
        row = _Row(text, line, begin, found.end())
        if text.lstrip(b" ").startswith(b"#") and not text.lower().startswith(_NOT_AVAILABLE_BYTES):
            comments.append(row)
        elif text:
            return row._replace(comments=tuple(comments))
        begin, line = found.end(), line + 1
    return _Row(b"", line, begin, begin, tuple(comments))


def _cells(row: _Row, dialect: Dialect) -> list[str]:
    try:
        text = row.text.decode()
        return next(csv.reader([text], delimiter=dialect.separator, strict=True))
    except UnicodeDecodeError as error:
        raise _not_utf8(error, row.line) from error
    except csv.Error as error:
        raise CsvError(f"is not CSV ({shortened(str(error))})", line=row.line) from error


def _not_utf8(error: UnicodeDecodeError, line: int) -> CsvError:
    byte = error.object[error.start]
    return CsvError(f"is not UTF-8 text (byte 0x{byte:02X}): save the file as UTF-8", line=line)


def _is_of_units(row: _Row, dialect: Dialect, width: int) -> bool:
    """Whether a row has units in its cells, and neither numbers nor times."""
    if len(row.text) > 20 * width + 200:
        return False
    try:
        cells = [cell.strip() for cell in _cells(row, dialect)] if row.text else []
    except CsvError:  # it is told where rows are read
        return False
    return (
        len(cells) == width
        and any(unit_of_text(cell) for cell in cells)
        and not any(map(WITH_UNIT.match, cells))
        and not any(cell.lower() in UNKNOWN - {""} for cell in cells)
    )


def _read_by_cells(
    columns: list[Column], rows: bytes, dialect: Dialect, known: Collection[str], required: Sequence[str]
) -> None:
    """Decide what first cells tell of columns.

    Those of times of day are clocks, and one of time without its unit becomes `time_s`. A name that is nearly
    a known one, over words such as `OK`, is another thing.
    """
    named = {column.name for column in columns}
    unnamed = [c for c in columns if not c.is_known and clock_name(c.text, known)]
    if "time_s" in named or len(unnamed) > 1:
        unnamed = []
    for place, column in enumerate(columns):
        if dialect.separator != "," and column.name not in required:
            column.decimal = own_decimal(_first_cells(rows, place, dialect), dialect.decimal)
        is_other = column.is_known and column.text != column.name and column.name not in required
        is_clock = (column.is_known and column.name in CLOCK_NAMES) or any(c is column for c in unnamed)
        if not is_clock and not is_other:
            continue
        cells = [cell for cell in _first_cells(rows, place, dialect) if cell.lower() not in UNKNOWN]
        if is_clock and cells and time_of(cells[0]) is not None:
            column.name = column.name if column.is_known else "time_s"
            column.is_known = column.is_clock = True
            column.factor, column.offset = 1.0, 0.0
        elif is_other and cells and _are_words(cells, column):
            column.name, column.is_known = column.text, False
            column.factor, column.offset = 1.0, 0.0


def _are_words(cells: Sequence[str], column: Column) -> bool:
    """Whether a column of numbers has none in its first cells, or one of labels has units there."""
    if column.is_text:
        return all(map(unit_of_text, cells))
    return not any(map(WITH_UNIT.match, cells))


def _first_cells(rows: bytes, place: int, dialect: Dialect) -> list[str]:
    """The first hundred cells of a column, as far as they are CSV; what is not is told later."""
    reader = csv.reader(io.StringIO(rows.decode(errors="replace"), newline=""), delimiter=dialect.separator)
    try:
        kept = (row for row in reader if len(row) > place and not row[0].lstrip().startswith("#"))
        return [row[place].strip() for row in itertools.islice(kept, 100)]
    except csv.Error:
        return []


COMMENTS = "comment lines are left out"


def read_rows(
    data: bytes,
    layout: Layout,
    first: int = 0,
    first_line: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Table]:
    """Read rows in a layout, from byte `first` on, which begins line `first_line`.

    A row that has not as many cells as the header is a fault in the layout's report, and left out.
    """
    width = len(layout.columns)
    most = max(1, BATCH_CELLS // width)
    held: list[list[str]] = []
    lines = array("q")
    for line, row in _parsed(data, first, first_line, layout, progress):
        if len(row) != width:
            hint = " (decimals are written with a point)" if len(row) == 2 * width else ""
            if len(row) == 1 and len(row[0].split()) == width:
                hint = f" (spaces separate its cells: {SAVE_WITH})"
            what = f"has {len(row)} cells where the header has {width}{hint}"
            layout.report.add_fault(CsvError(what, line=line))
            continue
        held.append(row)
        lines.append(line)
        if len(held) == most:
            yield Table(layout, held, lines)
            held, lines = [], array("q")
    if held:
        yield Table(layout, held, lines)


def _parsed(
    data: bytes,
    first: int,
    first_line: int,
    layout: Layout,
    progress: Callable[[float], None] | None = None,
) -> Iterator[tuple[int, list[str]]]:
    """Rows that are neither blank nor comments, each with the line it ends in."""
    lines = _Lines(data, first, first_line, layout, progress)
    reader = csv.reader(lines, delimiter=layout.dialect.separator, strict=True)
    try:
        for row in reader:
            lines.is_in_row = False
            if row:
                lines.since_row = 0
                yield lines.number - 1, row
    except csv.Error as error:
        line = max(lines.number - 1, first_line)
        raise CsvError(f"is not CSV ({shortened(str(error))})", line=line) from error


class _Lines:
    """The text's lines, decoded as they are asked for; refuses a row that has grown without end."""

    def __init__(
        self,
        data: bytes,
        first: int,
        first_line: int,
        layout: Layout,
        progress: Callable[[float], None] | None,
    ) -> None:
        self._bytes = io.BytesIO(data)  # shares them
        self._bytes.seek(first)
        self._text = io.TextIOWrapper(self._bytes, "utf-8", newline="")
        self._data = data
        self._first = first
        self._first_line = first_line
        self._layout = layout
        self.number = first_line
        self.since_row = 0
        self.is_in_row = False
        self._progress = progress

    def __iter__(self) -> Iterator[str]:
        while line := self._next_line():
            self.number += 1
            if self._progress is not None and self.number % TOLD_LINES == 0:
                self._progress(self._bytes.tell() / len(self._data))
            if line[0] in "# " and not self.is_in_row and self._layout.is_comment(line):
                self._layout.report.count(COMMENTS, f"line {self.number - 1}")
                continue
            self.is_in_row = True
            self.since_row += len(line)
            if self.since_row > MAX_ROW_CHARACTERS:
                what = f"the row, with blank lines before it, is longer than {MAX_ROW_CHARACTERS} characters"
                raise CsvError(what, line=self.number - 1)
            yield line

    def _next_line(self) -> str:
        try:
            return self._text.readline(MAX_ROW_CHARACTERS + 1)
        except UnicodeDecodeError as error:
            at = self._bytes.tell() - len(error.object) + error.start
            line = self._first_line + self._data.count(b"\n", self._first, at)
            raise _not_utf8(error, line) from error
