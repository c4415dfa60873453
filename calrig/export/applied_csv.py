"""Readings as CSV with their calibrated elevations in two further columns (`calrig apply`).

The stream is read in pieces of whole rows, so that a file of any length needs little memory.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import IO, Self

import numpy as np
import numpy.typing as npt

from calrig.calibration.results import Application
from calrig.estimation.angles import AXES, STANDARD_GRAVITY_MPS2, FloatArray
from calrig.export.csv_cells import Cells
from calrig.export.csv_columns import Column, missing_columns, normalised
from calrig.export.csv_dialect import csv_text
from calrig.export.csv_errors import CsvError, CsvReport
from calrig.export.csv_table import Layout, Table, layout_of, read_rows

PIECE_BYTES = 2_000_000
"""More than the rows that tell how cells are written (`csv_dialect.EXAMINED_BYTES`)."""
LONGEST_BYTES = 8_000_000
"""Of a piece without the end of a row in it."""


def pieces_of(stream: IO[bytes]) -> Iterator[bytes]:
    """Pieces that end where a row does: at the end of a line, outside of quotes.

    Raises:
        CsvError: a row, or what is between two quotes, has no end.
    """
    held, lines = b"", 1
    while more := stream.read(PIECE_BYTES):
        held += more
        end = _end_of_rows(held)
        if end:
            yield held[:end]
            lines += held.count(b"\n", 0, end)
            held = held[end:]
        elif len(held) > LONGEST_BYTES:
            raise CsvError(f"a row from here on is longer than {LONGEST_BYTES} bytes", line=lines)
    if held:
        yield held


_COMMENT = re.compile(rb"^ *#[^\n]*", re.MULTILINE)


def _end_of_rows(held: bytes) -> int:
    """Behind the last line's end that is outside of quotes; 0 without one."""
    end = held.rfind(b"\n") + 1
    quotes = held.count(b'"', 0, end)
    if quotes % 2 and b"#" in held:  # those in a comment belong to no cell
        quotes -= sum(comment.count(b'"') for comment in _COMMENT.findall(held, 0, end))
    while end and quotes % 2:
        before = held.rfind(b"\n", 0, end - 1) + 1
        quotes -= held.count(b'"', before, end)
        end = before
    return end


READING, TEMPERATURE = "reading_deg", "temperature_c"
ADDED = ("elevation_deg", "elevation_std_deg")
UNITS = {"g": 1.0, "mps2": STANDARD_GRAVITY_MPS2}
"""What an acceleration is divided by, by the unit in its column's name."""
OF_ROW, OF_EFFECTS = "and a row needs it", "and effects of the calibration follow it"
Triple = tuple[int | None, int, int]
"""Places of x (None where it is not there), y and z."""
NAMES = {READING, TEMPERATURE, *(f"accel_{axis}_{unit}" for axis in AXES for unit in UNITS)}


@dataclass(slots=True)
class _Rows:
    """Rows of which something is to be said: how many, and the line of the first."""

    n: int = 0
    first_line: int = 0

    def add(self, which: npt.NDArray[np.bool_], lines: Sequence[int]) -> None:
        found = np.flatnonzero(which)
        if len(found) and not self.n:
            self.first_line = lines[int(found[0])]
        self.n += len(found)

    def said(self, what: str) -> list[str]:
        rows = "1 row" if self.n == 1 else f"{self.n} rows"
        return [f"{rows}, the first in line {self.first_line}: {what}"] if self.n else []


@dataclass(slots=True)
class Applier:
    """Applies one calibration to one stream of readings."""

    application: Application
    _n: int = 0
    _beyond: _Rows = field(default_factory=_Rows)
    _warmer: _Rows = field(default_factory=_Rows)
    _many: _Rows = field(default_factory=_Rows)
    _report: CsvReport = field(default_factory=CsvReport)

    def rows(self, stream: IO[bytes]) -> Iterator[str]:
        """Yield what came, and two columns more, some rows at a time, the header first.

        Cells stay as they are; a number that is not known is a blank cell. Comments and a row of units are
        left out. After the first fault nothing more is yielded, and the rest is searched for others.

        Raises:
            CsvError: it is no such table, lacks a column, or a cell that is needed is no number; says where.
        """
        pieces = pieces_of(stream)
        first = next(pieces, b"")
        layout = layout_of(first, sorted(NAMES | set(self.application.columns)))
        self._report = layout.report
        place = _Places.of(layout, self.application)
        titles = map(_title, layout.columns, layout.units or [""] * len(layout.columns))
        begun = csv_text([[*titles, *ADDED]], layout.dialect.separator)
        begin, line = layout.begin, layout.first_line
        with layout.report as report:
            for piece in itertools.chain([first], pieces):
                for table in read_rows(piece, layout, begin, line):
                    applied = self._applied(table, place)
                    if not report.has_faults:
                        yield begun + applied
                        begun = ""
                line += piece.count(b"\n", begin)
                begin = 0
            if not self._n and not report.has_faults:
                raise CsvError("the file has a header and no rows", line=layout.header_line)

    def warnings(self) -> list[str]:
        """What is to be said once all rows are read."""
        low, high = self.application.range_deg
        said = self._report.notes() + self._beyond.said(
            f"the elevation is outside {low:g}° to {high:g}°, where the calibration says nothing of its worth"
        )
        if self.application.temperature_c is not None:
            coldest, warmest = self.application.temperature_c
            between = f"{coldest:.4g} to {warmest:.4g} °C"
            said += self._warmer.said(f"the temperature is outside {between}, where the unit was calibrated")
        said += self._many.said("the reading stands for many elevations, and none is given")
        if math.isnan(self.application.type_a_deg) or math.isnan(self.application.std_deg(np.zeros(1))[0]):
            said.append(
                "elevation_std_deg is blank: the calibration does not know what its reference is worth"
            )
        return said

    def _applied(self, table: Table, place: _Places) -> str:
        reading_deg, celsius = place.readings(table), place.temperatures(table)
        further = place.further(table)
        self._n += len(table.rows)
        if self._report.has_faults:
            return ""
        elevation = self.application.elevation_deg(reading_deg, celsius, further)
        std = self.application.std_deg(elevation, celsius, further)
        self._many.add(np.isnan(elevation), table.lines)
        self._beyond.add(self.application.beyond_range(elevation) > 0.0, table.lines)
        if celsius is not None:
            self._warmer.add(self.application.beyond_temperatures(celsius) > 0.0, table.lines)
        dialect = table.layout.dialect
        added = ([_text(value, dialect.decimal) for value in column.tolist()] for column in (elevation, std))
        rows = ([*row, *more] for row, *more in zip(table.rows, *added, strict=True))
        return csv_text(rows, dialect.separator)


@dataclass(frozen=True, slots=True)
class _Places:
    """Where in a row a calibration finds what it needs; None where there is no such column."""

    application: Application
    reading: int | None
    accel: Triple
    accel_unit: float
    others: dict[str, int]
    temperature: int | None

    @classmethod
    def of(cls, layout: Layout, application: Application) -> Self:
        header, line = layout.header, layout.header_line
        for name in ADDED:
            if name in header:
                raise CsvError("is there already: rename or leave it out", line=line, column=name)
        why = ", and effects of the calibration follow it"
        faults = missing_columns(layout.columns, application.columns, line, why)
        places: tuple[int | None, Triple, float] = None, (None, 0, 0), 1.0
        if (found := cls._readings_of(header)) is None:
            why = ", nor accel_y_g and accel_z_g in its place"
            faults = [*missing_columns(layout.columns, [READING], line, why), *faults]
        else:
            places = found
        with CsvReport() as report:
            for fault in faults:
                report.add_fault(fault)
        at = header.index
        others = {name: at(name) for name in application.columns if name != TEMPERATURE}
        temperature = at(TEMPERATURE) if TEMPERATURE in header else None
        return cls(application, *places, others, temperature)

    @staticmethod
    def _readings_of(header: list[str]) -> tuple[int | None, Triple, float] | None:
        at = header.index
        if READING in header:
            return at(READING), (None, 0, 0), 1.0
        for unit, worth in UNITS.items():
            x, y, z = (f"accel_{axis}_{unit}" for axis in AXES)
            if y in header and z in header:
                return None, (at(x) if x in header else None, at(y), at(z)), worth
        return None

    def readings(self, table: Table) -> FloatArray:
        """(n,) degrees."""
        if self.reading is not None:
            return _numbers(table.column(self.reading), table, OF_ROW)
        x, y, z = self.accel
        of_x = np.full(len(table.rows), np.nan) if x is None else _numbers(table.column(x), table)
        along = [_numbers(table.column(place), table, OF_ROW) for place in (y, z)]
        return self.application.reading_of_deg(np.column_stack([of_x, *along]) / self.accel_unit)

    def temperatures(self, table: Table) -> FloatArray | None:
        """(n,) °C, or None where there are none."""
        if self.temperature is None:
            return None
        needed = OF_EFFECTS if TEMPERATURE in self.application.columns else ""
        return _numbers(table.column(self.temperature), table, needed)

    def further(self, table: Table) -> dict[str, FloatArray]:
        """(n,) each, the other columns that effects follow."""
        return {name: _numbers(table.column(at), table, OF_EFFECTS) for name, at in self.others.items()}


def _numbers(cells: Cells, table: Table, needed: str = "") -> FloatArray:
    """(n,) NaN where not known, which is a fault of the file where the numbers are `needed`, and why."""
    values = cells.numbers(table.layout.report)
    if needed:
        cells.refuse(values, lambda value: value is None, f"is not known, {needed}", table.layout.report)
    return np.array(values, dtype=np.float64)


def _title(column: Column, unit: str) -> str:
    """The name as it came, with its unit where only the row of units, which is left out, told that."""
    is_told = not unit or not column.is_known or normalised(column.text) == column.name or "[" in column.text
    return column.text if is_told else f"{column.text} [{unit.strip()}]"


def _text(value: float, decimal: str) -> str:
    return "" if math.isnan(value) else f"{value:.9g}".replace(".", decimal)
