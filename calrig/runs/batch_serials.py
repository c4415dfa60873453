"""Serial numbers as a scanner, a person or a spreadsheet gives them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence

from calrig.analysis.errors import Invalid
from calrig.analysis.origin import check_serial

MOST_UNITS = 2000
NAMES = ("unit", "serial", "serial number", "serial_number", "sn")
"""Headings over the serials of a table."""


def checked(units: Sequence[str]) -> list[str]:
    """Serials without blanks around them, each once, lines without any left out.

    Raises:
        Invalid: none is left, or too many; or one is no serial, and which.
    """
    serials = list(dict.fromkeys(unit.strip() for unit in units if unit.strip()))
    if not serials:
        raise Invalid("no serial number was given: scan or paste some, one a line", ["units"])
    if len(serials) > MOST_UNITS:
        raise Invalid(f"a list has at most {MOST_UNITS} units, not {len(serials)}", ["units"])
    for number, serial in enumerate(serials, start=1):
        _check(serial, f"serial {number}", "units")
    return serials


def serials_in(table: str) -> tuple[list[str], int]:
    """The serials of a CSV, and how many rows have none.

    They are in the column headed `unit` or `serial`, else in the first, whose first row counts. A line
    `sep=;` before all others, which spreadsheets write, names the delimiter.

    Raises:
        Invalid: it is no CSV, or one is no serial; says in which line.
    """
    text = table.removeprefix("\ufeff")
    if "\ufffd" in text:
        raise Invalid("the file is not UTF-8: save it as “CSV UTF-8”", ["csv"])
    lines = list(io.StringIO(text, newline="")) or [""]
    named = re.fullmatch(r"sep=(.)\s*", lines[0])
    n_skipped = 1 if named else 0
    delimiter = named[1] if named else max(",;\t", key=lines[0].count)
    reader = csv.reader(lines[n_skipped:], delimiter=delimiter)
    try:
        rows = [(n_skipped + reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        raise Invalid(f"the file is no CSV: {error}", ["csv"]) from error
    headings = [cell.strip().casefold() for cell in rows[0][1]] if rows else []
    column = next((headings.index(name) for name in NAMES if name in headings), None)
    if column is None:
        column = 0
    else:
        del rows[0]
    found = [(line, row[column].strip() if len(row) > column else "") for line, row in rows]
    for line, serial in found:
        if serial:
            _check(serial, f"line {line}", "csv")
    serials = [serial for _, serial in found if serial]
    return serials, len(found) - len(serials)


def _check(serial: str, where: str, field: str) -> None:
    try:
        check_serial(serial)
    except Invalid as error:
        raise Invalid(f"{where}, {serial[:40]!a}: {error}", [field]) from error
