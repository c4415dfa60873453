"""The signs between cells and in decimals of a CSV file: as stated, else as its names and cells tell.

`csv_text` writes such a file.
"""

import csv
import io
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from calrig.export.csv_columns import MAX_COLUMNS, SAVE_WITH, names_a_known
from calrig.export.csv_errors import CsvError, CsvReport

SEPARATORS: tuple[str, ...] = (",", ";", "\t")
EXAMINED_BYTES = 1_000_000
"""Rows from which the decimal sign is detected: a different one further on is reported as a bad cell."""
_STATED_SEPARATOR = re.compile(rb'"?sep=([^"])"?', re.IGNORECASE)
"""The line that a spreadsheet writes before the header."""
_QUOTED = re.compile(r'"[^"]*"')
_COMMENTS = re.compile(rb"^ *#[^\r\n]*", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Dialect:
    """The sign between cells, and that in a decimal number."""

    separator: str = ","
    decimal: str = "."


COMMAS = Dialect()


def csv_text(rows: Iterable[Iterable[str]], separator: str = ",") -> str:
    """Return rows of cells as lines of a CSV file."""
    text = io.StringIO()
    csv.writer(text, delimiter=separator, lineterminator="\n").writerows(rows)
    return text.getvalue()


def stated_separator(row: bytes, line: int) -> str | None:
    """Return the separator that a line such as `sep=;` states; None of any other line.

    Raises:
        CsvError: it is none of `SEPARATORS`.
    """
    stated = _STATED_SEPARATOR.fullmatch(row)
    if stated is None:
        return None
    separator = stated[1].decode(errors="replace")
    if separator not in SEPARATORS:
        what = f"says that {separator!r} separates the cells: {SAVE_WITH}"
        raise CsvError(what, line=line)
    return separator


def dialect_of(
    header: bytes, rows: bytes, known: Collection[str], separators: tuple[str, ...] = SEPARATORS
) -> Dialect:
    """Return the dialect that the header row and the rows under it are in.

    The separator is the one that makes the most known names of the header, a comma where several do. Where
    cells are not separated by commas, decimals are written as in most cells that have any, with a point where
    as many have commas.
    """
    names = header.decode(errors="replace")
    separator = max(separators, key=lambda sign: _n_known(names, sign, known))
    if separator == ",":
        return COMMAS
    examined = _COMMENTS.sub(b"", rows[:EXAMINED_BYTES])
    comma = _n_decimals(examined, separator, ",") > _n_decimals(examined, separator, ".")
    return Dialect(separator, "," if comma else ".")


def has_known(header: bytes, known: Collection[str]) -> bool:
    """Return whether a line has a known name, whatever separates its cells."""
    names = header.decode(errors="replace")
    return any(_n_known(names, sign, known)[0] for sign in SEPARATORS)


def name_of_last(rows: bytes, dialect: Dialect, width: int, report: CsvReport) -> list[str]:
    """Return an empty name for the last cells of rows that all end in a separator, and say so; else none.

    `rows` is what follows the header row, at most `EXAMINED_BYTES`.
    """
    whole = rows if len(rows) < EXAMINED_BYTES else rows[: rows.rfind(b"\n") + 1]
    text = _COMMENTS.sub(b"", whole).decode(errors="replace")
    cells = csv.reader(io.StringIO(text, newline=""), delimiter=dialect.separator)
    has_rows = False
    try:
        for row in filter(None, cells):
            if len(row) != width + 1 or row[-1].strip():
                return []
            has_rows = True
    except csv.Error:  # it is told where rows are read
        return []
    if has_rows:
        report.say("the rows end in a separator, the names do not: it is left out")
    return [""] * has_rows


def _n_known(header: str, separator: str, known: Collection[str]) -> tuple[int, int]:
    """How many names a separator makes that are known, and how many at all where none is."""
    bare = _QUOTED.sub(lambda quoted: quoted[0].replace(separator, " "), header)
    names = [name.strip().strip('"') for name in bare.split(separator)]
    n_known = sum(names_a_known(name, known) for name in names[:MAX_COLUMNS])
    return n_known, 0 if n_known else len(names)


def _n_decimals(rows: bytes, separator: str, decimal: str) -> int:
    ends = rb'\r\n"' + separator.encode()
    number = rb" *[+-]?[0-9]*" + re.escape(decimal.encode()) + rb"[0-9]+(?:[eE][+-]?[0-9]+)?"
    unit = rb" *[^0-9.," + ends + rb"]{0,12}"
    return len(
        re.findall(rb"(?:(?<=[" + ends + rb"])|\A)" + number + unit + rb"(?=[" + ends + rb"]|\Z)", rows)
    )
