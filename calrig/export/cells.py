"""The cells of one column of a CSV file, and where in the file a bad one stands."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
    """One column: its name, its texts, the line each stands in, and the sign before their decimals."""

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
