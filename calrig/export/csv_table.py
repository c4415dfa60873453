"""Any bytes as rectangular tables of text cells with line numbers, in bounded memory; errors say where.

Separator and decimal sign are detected: comma and point, or the semicolon and comma of other spreadsheets.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

SEPARATORS = (",", ";", "\t")
EXAMINED_BYTES = 1_000_000
"""Rows from which the decimal sign is detected: a different one further on is reported as a bad cell."""
_QUOTED = re.compile(r'"[^"]*"')


@dataclass(frozen=True, slots=True)
class Dialect:
    """The sign between cells, and that in a decimal number."""

    separator: str = ","
    decimal: str = "."


COMMAS = Dialect()


def dialect_of(header: str, rows: bytes, is_known: Callable[[str], bool]) -> Dialect:
    """The dialect that the header row and the rows under it are in.

    The separator is the one that makes the most known names of the header, a comma where several do. Where
    cells are not separated by commas, these are decimal points if whole cells are numbers so, and none are
    numbers with a point: a file that has both is not guessed at.

    Args:
        header: the line of names.
        rows: what follows it.
        is_known: whether a column has a meaning here.
    """
    separator = max(SEPARATORS, key=lambda sign: _known(header, sign, is_known))
    if separator == ",":
        return COMMAS
    examined = rows[:EXAMINED_BYTES]
    comma = _has_decimals(examined, separator, ",") and not _has_decimals(examined, separator, ".")
    return Dialect(separator, "," if comma else ".")


def _known(header: str, separator: str, is_known: Callable[[str], bool]) -> tuple[int, int]:
    """How many names a separator makes that are known, and how many at all."""
    names = [name.strip().strip('"') for name in _unquoted(header, separator).split(separator)]
    return sum(map(is_known, names)), 0 if any(map(is_known, names)) else len(names)


def _unquoted(header: str, separator: str) -> str:
    """The header with what is quoted free of the separator."""
    return _QUOTED.sub(lambda quoted: quoted[0].replace(separator, " "), header)


def _has_decimals(rows: bytes, separator: str, decimal: str) -> bool:
    between = rb'[\r\n"' + separator.encode() + rb"]"
    number = rb"[ ]*[+-]?[0-9]*" + re.escape(decimal.encode()) + rb"[0-9]+(?:[eE][+-]?[0-9]+)?[ ]*"
    return re.search(rb"(?:\A|" + between + rb")" + number + rb"(?:\Z|" + between + rb")", rows) is not None


LARGEST = 1e30
"""No quantity a rig knows is larger; sums of squares of what is smaller stay finite."""

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
"""A decimal number; unlike `float`, neither `1_000` nor digits of other scripts."""
_FORMULA = re.compile(r"'*[=+\-@＝＋－＠]")
"""What a spreadsheet would take for a formula: our own quotes, then what begins one."""
_UNKNOWN = frozenset({"", "nan", "na", "n/a", "null", "none"})


def for_spreadsheet(text: str) -> str:
    """A text for a cell; one that a spreadsheet would evaluate as a formula gets a quote before it."""
    return f"'{text}" if _FORMULA.match(text) else text


def from_spreadsheet(text: str) -> str:
    """The text that `for_spreadsheet` made a cell of."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


class CsvError(ValueError):
    """The file cannot be read: `line` (from 1, with the header) and `column` are at fault, or None."""

    def __init__(self, what: str, *, line: int | None = None, column: str | None = None) -> None:
        self.what = what
        self.line = line
        self.column = column
        place = [f"line {line}"] if line is not None else []
        place += [f"column {_shortened(column)}"] if column is not None else []
        super().__init__(f"{', '.join(place)}: {what}" if place else what)


def _shortened(text: str) -> str:
    """A cell's text fit for a message: one line, at most 60 characters, nothing unprintable."""
    shown = text if len(text) <= 60 else f"{text[:57]}..."
    return shown if shown.isprintable() else repr(shown)[1:-1]


@dataclass(frozen=True, slots=True)
class Cells:
    """One column: its name, its texts, the line of each, and the decimal sign."""

    name: str
    texts: Sequence[str]
    lines: Sequence[int]
    decimal: str = "."

    def numbers(self) -> list[float | None]:
        """The cells as numbers; None where blank or `nan`.

        Raises:
            CsvError: a cell is something else, or infinite, or absurdly large.
        """
        return [self._number(text, line) for text, line in zip(self.texts, self.lines, strict=True)]

    def _number(self, text: str, line: int) -> float | None:
        stripped = text.strip()
        if stripped.lower() in _UNKNOWN:
            return None
        other, sign = (",", "point") if self.decimal == "." else (".", "comma")
        number = stripped.replace(",", ".") if self.decimal == "," else stripped
        if other in stripped or not NUMBER.fullmatch(number):
            is_other = re.fullmatch(rf"[+-]?[0-9]+{re.escape(other)}[0-9]+", stripped)
            hint = f" (decimals are written with a {sign})" if is_other else ""
            raise CsvError(f"'{_shortened(text)}' is not a number{hint}", line=line, column=self.name)
        value = float(number)
        if not math.fabs(value) <= LARGEST:
            raise CsvError(f"'{_shortened(text)}' is beyond ±{LARGEST:g}", line=line, column=self.name)
        return value

    def refuse_first(
        self, values: Sequence[float | None], is_bad: Callable[[float | None], bool], why: str
    ) -> None:
        """Raises CsvError at the first bad value."""
        for value, text, line in zip(values, self.texts, self.lines, strict=True):
            if is_bad(value):
                raise CsvError(f"'{_shortened(text)}' {why}", line=line, column=self.name)


MAX_BYTES = 150_000_000
MAX_COLUMNS = 200
MAX_ROWS = 100_000
MAX_CELLS = 2_000_000
"""Bounds what a file of short cells takes in memory."""
MAX_ROW_CHARACTERS = 1_000_000
MOST_NAMED = 30
BATCH_CELLS = 50_000
"""Held as texts at once, which take ten times the memory of numbers."""
TOLD_LINES = 1000
"""The progress is reported every so many lines."""


@dataclass(frozen=True, slots=True)
class Table:
    """A header and rows of as many cells; lines count from 1, and a row's line is the one it ends in."""

    header: list[str]
    header_line: int
    rows: list[list[str]]
    lines: Sequence[int]
    dialect: Dialect = COMMAS

    def column(self, place: int) -> Cells:
        """The cells of one column."""
        texts = [row[place] for row in self.rows]
        return Cells(self.header[place], texts, self.lines, self.dialect.decimal)


def read_tables(
    data: bytes,
    required: Sequence[str],
    *,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Table]:
    """Reads UTF-8 CSV with a header row; BOM, CRLF and blank lines are accepted.

    Cells are separated by commas, or by semicolons or tabs, which allow of decimal commas (`dialect_of`).
    `progress` gets the share that is read, 0 to 1.

    Yields:
        The rows in the order of the file, some at a time, each time under the same header.

    Raises:
        CsvError: not UTF-8, empty, no rows, a required column missing, a name twice, a ragged row, broken
            quotes, or too large.
    """
    if len(data) > MAX_BYTES:
        raise CsvError(f"the file has {len(data)} bytes; at most {MAX_BYTES} are read")
    dialect = _dialect(data, required)
    rows = _parsed(data, 0, 1, dialect, "utf-8-sig", progress)
    line, names = next(rows, (0, []))
    if not names:
        raise CsvError("the file is empty")
    header = _header(names, line, required)
    n = 0
    for table in _batches(rows, header, line, dialect):
        n += len(table.rows)
        if n > MAX_ROWS:
            at = table.lines[len(table.rows) - (n - MAX_ROWS)]
            raise CsvError(f"the file has more than {MAX_ROWS} rows", line=at)
        if n * len(header) > MAX_CELLS:
            at = table.lines[MAX_CELLS // len(header) - (n - len(table.rows))]
            raise CsvError(f"the file has more than {MAX_CELLS} cells", line=at)
        yield table
    if n == 0:
        raise CsvError("the file has a header and no rows", line=line)


def _dialect(data: bytes, required: Sequence[str]) -> Dialect:
    """The dialect of a whole file, by the names that it must have."""
    start = data[: MAX_ROW_CHARACTERS + 1].removeprefix(codecs.BOM_UTF8).lstrip(b"\r\n")
    lines = re.split(rb"\r\n|\r|\n", start, maxsplit=1)
    return dialect_of(lines[0].decode(errors="replace"), b"".join(lines[1:]), lambda name: name in required)


def read_header(line_of_names: bytes, line: int, dialect: Dialect) -> list[str]:
    """Return the column names of a header row in this line, checked as `read_tables` does."""
    return _header(next(_parsed(line_of_names, 0, line, dialect))[1], line, ())


def read_rows(
    data: bytes, first: int, header: list[str], first_line: int, dialect: Dialect
) -> Iterator[Table]:
    """Reads rows under a header read before, from byte `first` on, which begins line `first_line`."""
    return _batches(_parsed(data, first, first_line, dialect), header, first_line, dialect)


def _batches(
    rows: Iterator[tuple[int, list[str]]], header: list[str], header_line: int, dialect: Dialect
) -> Iterator[Table]:
    most = max(1, BATCH_CELLS // len(header))
    held: list[list[str]] = []
    lines = array("q")
    for line, row in rows:
        _check_row(row, len(header), line)
        held.append(row)
        lines.append(line)
        if len(held) == most:
            yield Table(header, header_line, held, lines, dialect)
            held, lines = [], array("q")
    if held:
        yield Table(header, header_line, held, lines, dialect)


def _parsed(
    data: bytes,
    first: int,
    first_line: int,
    dialect: Dialect,
    encoding: str = "utf-8",
    progress: Callable[[float], None] | None = None,
) -> Iterator[tuple[int, list[str]]]:
    """Rows that are not blank, each with the line it ends in."""
    lines = _Lines(data, first, first_line, encoding, progress)
    reader = csv.reader(lines, delimiter=dialect.separator, strict=True)
    try:
        for row in reader:
            if row:
                lines.since_row = 0
                yield first_line - 1 + reader.line_num, row
    except csv.Error as error:
        line = first_line - 1 + max(reader.line_num, 1)
        raise CsvError(f"is not CSV ({error})", line=line) from error


class _Lines:
    """The text's lines, decoded as they are asked for; refuses a row that has grown without end."""

    def __init__(
        self,
        data: bytes,
        first: int,
        first_line: int,
        encoding: str,
        progress: Callable[[float], None] | None,
    ) -> None:
        self._bytes = io.BytesIO(data)  # shares them
        self._bytes.seek(first)
        self._text = io.TextIOWrapper(self._bytes, encoding, newline="")
        self._data = data
        self._first = first
        self._first_line = first_line
        self.since_row = 0
        self._progress = progress

    def __iter__(self) -> Iterator[str]:
        number = self._first_line
        while line := self._next_line():
            self.since_row += len(line)
            if self.since_row > MAX_ROW_CHARACTERS:
                raise CsvError(
                    f"the row, with blank lines before it, is longer than {MAX_ROW_CHARACTERS} characters",
                    line=number,
                )
            yield line
            number += 1
            if self._progress is not None and number % TOLD_LINES == 0:
                self._progress(self._bytes.tell() / len(self._data))

    def _next_line(self) -> str:
        try:
            return self._text.readline(MAX_ROW_CHARACTERS + 1)
        except UnicodeDecodeError as error:
            at = self._bytes.tell() - len(error.object) + error.start
            raise CsvError(
                f"is not UTF-8 text (byte 0x{error.object[error.start]:02X}): save the file as UTF-8",
                line=self._first_line + self._data.count(b"\n", self._first, at),
            ) from error


def _header(row: list[str], line: int, required: Sequence[str]) -> list[str]:
    names = [from_spreadsheet(name.strip()) for name in row]
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
    if all(NUMBER.fullmatch(name) for name in names):
        return ": the first line holds numbers, and the column names must come before it"
    return f"; {there_are(names)}"


def there_are(names: Sequence[str]) -> str:
    """The columns that a file has, in so many words as a message bears."""
    shown = ", ".join(name for name in names[:MOST_NAMED] if name) or "none with a name"
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return f"there are: {shown}{more} (calrig/docs/reference/file-formats.md lists the columns)"


def _check_row(row: list[str], width: int, line: int) -> None:
    if len(row) != width:
        hint = " (decimals are written with a point)" if len(row) == 2 * width else ""
        raise CsvError(f"has {len(row)} cells where the header has {width}{hint}", line=line)
