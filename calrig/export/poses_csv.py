"""Poses as CSV, both ways (CONTRACT section 4)."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from calrig.calibration.pose import COLUMNS, INTEGER, REQUIRED, Pose
from calrig.export.cells import Cells, CsvError
from calrig.export.csv_table import read_table

__all__ = ["CsvError", "ImportedPoses", "read_poses", "write_poses"]

MAX_COUNT = 2**53
"""The largest whole number that a float holds exactly."""

Column = Sequence[float | int | None]


@dataclass(frozen=True, slots=True)
class ImportedPoses:
    """The poses of a file in the order measured, and what a person should know about how they were read."""

    poses: list[Pose]
    warnings: list[str]


def read_poses(data: bytes) -> ImportedPoses:
    """Reads the poses of a CSV file.

    Rows that do not follow one another in time are sorted by `time_s`; a column that is neither known nor
    numeric, has no name or no value, is left out; each with a warning.

    Raises:
        CsvError: the file is not such a table; says line and column.
    """
    table = read_table(data, REQUIRED)
    warnings: list[str] = []
    columns: dict[str, Column] = {}
    for place, name in enumerate(table.header):
        cells = table.column(place)
        if name in COLUMNS:
            columns[name] = _known(cells)
            continue
        covariate, why_not = _covariate(cells, table.header_line)
        if covariate is not None:
            columns[name] = covariate
        else:
            warnings.append(f"column {name or place + 1}: {why_not}; left out")
    rows = (dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True))
    return _in_time([Pose.from_row(row) for row in rows], warnings)


def write_poses(poses: Sequence[Pose]) -> str:
    """The poses as CSV that `read_poses` reads back exactly; a column known in no pose is left out."""
    rows = [pose.row() for pose in poses]
    names = list(dict.fromkeys([*COLUMNS, *(name for row in rows for name in row)]))
    kept = [n for n in names if n in REQUIRED or any(row.get(n) is not None for row in rows)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(kept)
    writer.writerows([_text(row.get(name)) for name in kept] for row in rows)
    return text.getvalue()


def _text(value: float | int | None) -> str:
    return "" if value is None else repr(value)


def _known(cells: Cells) -> Column:
    values = cells.numbers()
    if cells.name in REQUIRED:
        cells.refuse_first(values, lambda value: value is None, "is not known, and a pose needs it")
    if cells.name not in INTEGER:
        return values
    cells.refuse_first(values, lambda value: value is not None and not value.is_integer(), "is not whole")
    if cells.name == "approach":
        cells.refuse_first(values, lambda value: value not in {None, -1.0, 0.0, 1.0}, "is none of -1, 0, 1")
    else:
        cells.refuse_first(
            values, lambda value: value is not None and not 0 <= value <= MAX_COUNT, "is not a count"
        )
    return [None if value is None else int(value) for value in values]


def _covariate(cells: Cells, header_line: int) -> tuple[Column | None, str]:
    if not cells.name:
        return None, "has no name"
    if cells.name[0] in "=+-@":
        raise CsvError(
            "a spreadsheet would take this name for a formula: begin it with a letter",
            line=header_line,
            column=cells.name,
        )
    try:
        values = cells.numbers()
    except CsvError as error:
        return None, f"is not numeric (line {error.line}: {error.what})"
    return (values, "") if any(value is not None for value in values) else (None, "has no values")


def _in_time(poses: list[Pose], warnings: list[str]) -> ImportedPoses:
    times = [pose.time_s for pose in poses if pose.time_s is not None]
    if all(before <= after for before, after in itertools.pairwise(times)):
        return ImportedPoses(poses, warnings)
    if len(times) < len(poses):
        warnings.append("time_s goes backwards and is not known for every row; the rows are left as they are")
        return ImportedPoses(poses, warnings)
    warnings.append("the rows were not in order of time_s; they are sorted by it")
    return ImportedPoses(sorted(poses, key=_time_of), warnings)


def _time_of(pose: Pose) -> float:
    return 0.0 if pose.time_s is None else pose.time_s
