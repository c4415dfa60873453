"""The cells of a CSV file: numbers, times of day, units and a spreadsheet's own words; errors say where."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from calrig.export.csv_columns import NUMBER, Column
from calrig.export.csv_errors import CsvError, CsvReport, shortened
from calrig.export.csv_units import unit_of_text

LARGEST = 1e30
"""No quantity a rig knows is larger; sums of squares of what is smaller stay finite."""

_FORMULA = re.compile(r"'*[=+\-@＝＋－＠]")
"""What a spreadsheet would take for a formula: our own quotes, then what begins one."""
UNKNOWN = frozenset({"", "nan", "na", "n/a", "null", "none"})
NOT_AVAILABLE = ("#n/a", "#na", "#nv")
"""A spreadsheet's word for a value that is not known, in English and German."""
ERROR = re.compile(r"#[^\W_]+(?:/0)?[!?]")
"""What a spreadsheet shows in place of a value that it cannot calculate: `#DIV/0!`, `#WERT!`, `#NAME?`."""
WITH_UNIT = re.compile(r"([+\-−]?[0-9.,]+(?:[eE][+-]?[0-9]+)?)\s*(.*)", re.DOTALL)
_CLOCK = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}[T ][0-9]{2}:[0-9]{2}.*")


def for_spreadsheet(text: str) -> str:
    """A text for a cell; one that a spreadsheet would evaluate as a formula gets a quote before it."""
    return f"'{text}" if _FORMULA.match(text) else text


def from_spreadsheet(text: str) -> str:
    """The text that `for_spreadsheet` made a cell of."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


def time_of(text: str) -> datetime | None:
    """The time that a text says as ISO 8601, date and time of day."""
    try:
        return datetime.fromisoformat(text) if _CLOCK.fullmatch(text) else None
    except ValueError:
        return None


@dataclass(frozen=True, slots=True)
class Cells:
    """One column: what it is, its texts, the line of each, and the decimal sign."""

    column: Column
    texts: Sequence[str]
    lines: Sequence[int]
    decimal: str = "."

    def numbers(self, report: CsvReport) -> list[float | None]:
        """Return the cells as numbers in the unit of the column's name; None where blank or `nan`.

        A cell that is something else, or infinite, or absurdly large, is a fault in the report, and NaN.
        """
        found = [self._number(text, line, report) for text, line in zip(self.texts, self.lines, strict=True)]
        if self.column.is_converted:
            factor, offset = self.column.factor, self.column.offset
            return [None if value is None else value * factor + offset for value in found]
        return found

    def _number(self, text: str, line: int, report: CsvReport) -> float | None:
        stripped = text.strip()
        if self.column.is_clock:
            return self._seconds(stripped, line, report)
        number = stripped.replace(",", ".") if self.decimal == "," and "." not in stripped else stripped
        if NUMBER.fullmatch(number) and (self.decimal == "." or "." not in stripped):
            value = float(number)
            if math.fabs(value) <= LARGEST:
                return value
            return self._fault(f"'{shortened(text)}' is beyond ±{LARGEST:g}", line, report)
        if stripped.lower() in UNKNOWN:
            return None
        return self._unusual(stripped, line, report)

    def _unusual(self, text: str, line: int, report: CsvReport) -> float | None:
        """A cell that is not simply a number."""
        if text.lower() in NOT_AVAILABLE:
            where = f"line {line}, column {self.column.text}"
            report.count(f"cells with {text} are read as not known", where)
            return None
        parts = WITH_UNIT.fullmatch(text)
        unit = unit_of_text(parts[2]) if parts is not None else None
        if parts is not None and (unit is not None or "−" in parts[1]):
            if unit in {None, self.column.unit} and not (unit is None and parts[2]):
                plain = parts[1].replace("−", "-")
                if NUMBER.fullmatch(plain.replace(",", ".")) and self.decimal_of(plain) in {"", self.decimal}:
                    where = f"line {line}, column {shortened(self.column.text)}: '{shortened(text)}'"
                    report.count("cells with a unit or a typographic minus are read as numbers", where)
                    return self._number(plain, line, report)
            elif unit is not None and self.column.unit is not None:
                what = f"'{shortened(text)}' is in {unit}, and the column in {self.column.unit}"
                return self._fault(what, line, report)
        other, sign = (",", "point") if self.decimal == "." else (".", "comma")
        is_other = re.fullmatch(rf"[+-]?[0-9]+{re.escape(other)}[0-9]+", text)
        hint = f" (decimals are written with a {sign})" if is_other else ""
        return self._fault(f"'{shortened(text)}' is not a number{hint}", line, report)

    @staticmethod
    def decimal_of(number: str) -> str:
        """Return the decimal sign in a number, empty without one."""
        return "," if "," in number else "." if "." in number else ""

    def _seconds(self, text: str, line: int, report: CsvReport) -> float | None:
        """A time of day as seconds since the column's first."""
        if text.lower() in UNKNOWN:
            return None
        time, first = time_of(text), self.column.first
        if time is None or (first is not None and (time.tzinfo is None) != (first.tzinfo is None)):
            what = f"'{shortened(text)}' is no time as in the first row (date, time of day, offset or none)"
            return self._fault(what, line, report)
        if first is None:
            self.column.first = first = time
        return (time - first).total_seconds()

    def _fault(self, what: str, line: int, report: CsvReport) -> float:
        report.add_fault(CsvError(what, line=line, column=self.column.text))
        return math.nan

    def refuse(
        self,
        values: Sequence[float | None],
        is_bad: Callable[[float | None], bool],
        why: str,
        report: CsvReport,
    ) -> None:
        """Add a fault for each bad value; NaN has its own."""
        for value, text, line in zip(values, self.texts, self.lines, strict=True):
            if (value is None or not math.isnan(value)) and is_bad(value):
                self._fault(f"'{shortened(text)}' {why}", line, report)
