"""Report on a CSV file: everything that is wrong in it with its place, and how unusual cells were read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import TracebackType

MOST_SHOWN = 10
"""Faults in one message; the others are counted."""
_MOST_KEPT = 1000


class CsvError(ValueError):
    """The file cannot be read: `line` (from 1, with the header) and `column` are at fault, or None.

    `of` are the first of several faults, and how many there are; None of a single one.
    """

    def __init__(self, what: str, *, line: int | None = None, column: str | None = None) -> None:
        self.what = what
        self.line = line
        self.column = column
        self.of: tuple[Sequence[CsvError], int] | None = None
        place = [f"line {line}"] if line is not None else []
        place += [f"column {shortened(column)}"] if column is not None else []
        super().__init__(f"{', '.join(place)}: {what}" if place else what)

    @classmethod
    def of_all(cls, faults: Sequence[CsvError], n: int) -> CsvError:
        """Return one error of several, the first of `n`; its place is that of the first."""
        first, *others = faults
        if n == 1:
            return first
        more = [f"and {n - len(faults)} more"] if n > len(faults) else []
        whole = cls("; ".join([first.what, *map(str, others), *more]), line=first.line, column=first.column)
        whole.what, whole.of = first.what, (faults, n)
        return whole


def shortened(text: str) -> str:
    """Return a text fit for a message: one line, at most 60 characters, nothing unprintable."""
    shown = text if len(text) <= 60 else f"{text[:57]}..."
    return shown if shown.isprintable() else repr(shown)[1:-1]


@dataclass(slots=True)
class CsvReport:
    """Faults and remarks of one file as it is read. As a context, it raises all faults at its end."""

    _faults: list[CsvError] = field(default_factory=list)
    _n_faults: int = 0
    _said: list[str] = field(default_factory=list)
    _seen: dict[str, tuple[int, str]] = field(default_factory=dict)

    @property
    def has_faults(self) -> bool:
        """Whether anything is wrong so far."""
        return self._n_faults > 0

    @property
    def first_fault(self) -> CsvError:
        """The first one in the file."""
        return min(self._faults, key=_line)

    def add_fault(self, fault: CsvError) -> None:
        """Add what is wrong."""
        self._n_faults += 1
        self._faults.append(fault)
        if len(self._faults) > _MOST_KEPT:
            self._faults = sorted(self._faults, key=_line)[:MOST_SHOWN]

    def forgive(self) -> None:
        """Take back all faults."""
        self._faults.clear()
        self._n_faults = 0

    def say(self, sentence: str) -> None:
        """Add a remark on the whole file."""
        self._said.append(sentence)

    def count(self, kind: str, first: str) -> None:
        """Add a remark of a kind that may come many times: only the first place is kept."""
        n, where = self._seen.get(kind, (0, first))
        self._seen[kind] = n + 1, where

    def take(self, other: CsvReport) -> None:
        """Add the counted remarks of another report."""
        for kind, (n, where) in other._seen.items():
            own, first = self._seen.get(kind, (0, where))
            self._seen[kind] = own + n, first

    def notes(self) -> list[str]:
        """Return what is to be said of how the file was read, a line a kind."""
        return self._said + [f"{kind}: {n}, the first in {where}" for kind, (n, where) in self._seen.items()]

    def __enter__(self) -> CsvReport:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, CsvError):
            faults, n = error.of or ([error], 1)
            self._faults = [*faults, *self._faults]
            self._n_faults += n
        elif error is not None:
            return
        if self._faults:
            shown = sorted(self._faults, key=_line)[:MOST_SHOWN]
            raise CsvError.of_all(shown, self._n_faults) from error


def _line(fault: CsvError) -> int:
    return fault.line or 0
