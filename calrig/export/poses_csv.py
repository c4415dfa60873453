"""Poses as CSV, read and written (CONTRACT section 4), also of several mounts and units in one file."""

from __future__ import annotations

import itertools
import math
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast, get_args, overload

import numpy as np

from calrig.calibration.line import cut_above_deg
from calrig.calibration.poses import COLUMNS, FEW, HOST_TIME, INTEGER, MOUNT_DEG, OF_MOUNTS, REQUIRED, Pose
from calrig.calibration.separation import FACES, MountedPoses
from calrig.estimation.angles import FloatArray
from calrig.export.csv_cells import Cells, for_spreadsheet, from_spreadsheet
from calrig.export.csv_dialect import csv_text
from calrig.export.csv_errors import CsvError, CsvReport
from calrig.export.csv_table import read_tables
from calrig.model.result import MOST_REFERENCE_STD_DEG, StatedKind

MAX_COUNT = 2**53
"""The largest whole number that a float holds exactly."""


@dataclass(frozen=True, slots=True)
class ImportedPoses:
    """The poses of a file in the order measured, and what a person should know about how they were read."""

    poses: list[Pose]
    warnings: list[str]


class PoseColumns(Sequence[Pose]):
    """Poses as columns of eight bytes a cell, NaN where not known; each pose is made when it is asked for.

    `columns` are by the contract's names or those of covariates, all of one length.
    """

    def __init__(self, columns: dict[str, array[float]]) -> None:
        self._columns = columns

    def __len__(self) -> int:
        return len(self._columns["target_deg"])

    @overload
    def __getitem__(self, place: int) -> Pose: ...
    @overload
    def __getitem__(self, place: slice) -> list[Pose]: ...
    def __getitem__(self, place: int | slice) -> Pose | list[Pose]:
        if isinstance(place, int):
            place = range(len(self))[place]  # IndexError beyond the end
            return self[place : place + 1][0]
        cells = (_known(column[place], name in INTEGER) for name, column in self._columns.items())
        return [Pose.from_row(dict(zip(self._columns, row, strict=True))) for row in zip(*cells, strict=True)]

    def cells(self, name: str) -> list[float | None] | None:
        """A column, None where not known; None where there is none of this name."""
        column = self._columns.get(name)
        return None if column is None else [None if math.isnan(cell) else cell for cell in column]

    def on_one_arc(self) -> tuple[PoseColumns, list[str]]:
        """The poses with their targets as of `_on_one_arc`, and what is to be said of it."""
        target, reading = (np.array(self._columns[name]) for name in REQUIRED)
        mount = np.nan_to_num(np.array(self._columns.get(MOUNT_DEG, np.zeros(len(self)))))
        target, said = _on_one_arc(target, reading - mount)
        return PoseColumns({**self._columns, "target_deg": array("d", target)}) if said else self, said

    def in_time(self) -> tuple[PoseColumns, list[str]]:
        """The poses by `time_s` if each has one, and what is to be said where they were not so."""
        order, said = self.order_in_time()
        if isinstance(order, range):
            return self, said
        ordered = {name: array("d", map(column.__getitem__, order)) for name, column in self._columns.items()}
        return PoseColumns(ordered), said

    def order_in_time(self) -> tuple[Sequence[int], list[str]]:
        """The rows by `time_s` if each has one, as a range where they are so, and what is to be said."""
        as_they_are = range(len(self))
        times = self._columns.get("time_s", array("d"))
        known = [time for time in times if not math.isnan(time)]
        if all(before <= after for before, after in itertools.pairwise(known)):
            return as_they_are, []
        if len(known) < len(self):
            said = "time_s goes backwards and is not known for every row; the rows are left as they are"
            return as_they_are, [said]
        order = sorted(as_they_are, key=times.__getitem__)
        return order, ["the rows were not in order of time_s; they are sorted by it"]


def _on_one_arc(target_deg: FloatArray, reading_deg: FloatArray) -> tuple[FloatArray, list[str]]:
    """Targets with the circle cut where they leave a hole, if `cut_above_deg` says so, and that it was."""
    above_deg = cut_above_deg(target_deg, reading_deg)
    if above_deg is None:
        return target_deg, []
    said = f"targets above {above_deg:g}° were taken as less by 360°: readings or rows go on over 0° there"
    return target_deg - 360.0 * (target_deg > above_deg), [said]


def _known(cells: Iterable[float], whole: bool) -> Iterator[float | int | None]:
    return (None if math.isnan(cell) else int(cell) if whole else cell for cell in cells)


def read_poses(data: bytes) -> ImportedPoses:
    """Reads the poses of a CSV file.

    Rows that do not follow one another in time are sorted by `time_s`; a column that is neither known nor
    numeric, has no name or no value, is left out; each with a warning.

    Raises:
        CsvError: the file is not such a table; says line and column.
    """
    poses, _, warnings = read_labelled_columns(data, ())
    ordered, of_time = poses.in_time()
    return ImportedPoses(ordered[:], [*warnings, *of_time])


Labels = dict[str, str]
"""Texts of a pose by column."""


@dataclass(frozen=True, slots=True)
class Texts:
    """A column of text: its cells, and the line of each."""

    texts: list[str]
    lines: list[int]


def read_labelled_columns(
    data: bytes, labels: Sequence[str], progress: Callable[[float], None] | None = None
) -> tuple[PoseColumns, dict[str, Texts], list[str]]:
    """Return columns of numbers and of text, in the order of the file, and how they were read.

    Few rows that lack an angle or a reading are left out; more are refused.
    """
    with CsvReport() as unknown:
        columns, texts, report = _columns_of(data, labels, unknown, progress)
        angles, readings = (next(c.cells for c in columns if c.name == name) for name in REQUIRED)
        is_whole = [not math.isnan(angle + reading) for angle, reading in zip(angles, readings, strict=True)]
        lacking, warnings = is_whole.count(False), []
        if 0 < lacking <= FEW * len(is_whole):
            said = f"{lacking} of {len(is_whole)} rows lack {' or '.join(REQUIRED)} and are left out"
            warnings.append(f"{said}, the first in line {unknown.first_fault.line}")
            unknown.forgive()
    kept = {}
    for place, column in enumerate(columns):
        if column.name in texts:
            continue
        if why := column.why_left_out():
            warnings.append(f"column {column.name or place + 1}: {why}; left out")
        else:
            kept[column.name] = array("d", itertools.compress(column.cells, is_whole))
            report.take(column.remarks)
    whole = {
        name: Texts(
            list(itertools.compress(one.texts, is_whole)), list(itertools.compress(one.lines, is_whole))
        )
        for name, one in texts.items()
    }
    return PoseColumns(kept), whole, [*report.notes(), *warnings]


def _columns_of(
    data: bytes,
    labels: Sequence[str],
    unknown: CsvReport,
    progress: Callable[[float], None] | None,
) -> tuple[list[_Column], dict[str, Texts], CsvReport]:
    """Return all columns of a file; blank angles and readings are faults in the report `unknown`."""
    columns: list[_Column] = []
    texts: dict[str, Texts] = {}
    report = CsvReport()
    for table in read_tables(data, _KNOWN, REQUIRED, progress=progress):
        report = table.layout.report
        columns = columns or [_Column(name) for name in table.layout.header]
        for place, column in enumerate(columns):
            if column.name in labels:
                cells, said = table.column(place), texts.setdefault(column.name, Texts([], []))
                if column.name == REFERENCE_STD:  # as a number, which its unit and its decimal comma change
                    values = cells.numbers(report)
                    said.texts.extend("" if value is None else repr(value) for value in values)
                else:
                    said.texts.extend(from_spreadsheet(text.strip()) for text in cells.texts)
                said.lines.extend(cells.lines)
            else:
                column.take(table.column(place), report, unknown)
    return columns, texts, report


def write_poses(poses: Sequence[Pose], labels: Callable[[Pose], Labels] | None = None) -> str:
    """The poses as CSV that `read_poses` reads back exactly; a column known in no pose is left out."""
    return "".join(write_pose_batches(lambda: [poses], labels))


def write_pose_batches(
    batches: Callable[[], Iterable[Iterable[Pose]]], labels: Callable[[Pose], Labels] | None = None
) -> Iterator[str]:
    """The same, piece by piece, the header first.

    `batches` are poses, some at a time; asked twice, since the header tells what all of them know. `labels`
    are the texts of a pose by column, the same columns of each.
    """
    names, known = dict.fromkeys(COLUMNS), set(REQUIRED)
    for pose in itertools.chain.from_iterable(batches()):
        names.update(dict.fromkeys(pose.covariates))
        known.update(name for name, value in pose.row().items() if value is not None)
    kept = [name for name in names if name in known]
    first = next((pose for batch in batches() for pose in batch), None)
    texts = [] if labels is None or first is None else list(labels(first))
    yield csv_text([[for_spreadsheet(name) for name in (*kept, *texts)]])

    def cells(pose: Pose) -> Iterator[str]:
        row, said = pose.row(), {} if labels is None else labels(pose)
        yield from ("" if (value := row.get(name)) is None else repr(value) for name in kept)
        yield from (said[name] for name in texts)

    for batch in batches():
        yield csv_text(map(cells, batch))


class _Column:
    """A column as it grows; eight bytes a cell, NaN where it is not known.

    `remarks` are on how cells were read, for as long as the column is not left out.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.cells = array("d")
        self.remarks = CsvReport()
        self._why_not = "" if name else "has no name"

    def take(self, cells: Cells, report: CsvReport, unknown: CsvReport) -> None:
        """Add the next cells; what a column of the contract cannot hold is a fault in a report."""
        if self._why_not:
            return
        if self.name in (*COLUMNS, MOUNT_DEG):
            values = cells.numbers(report)
            _check(cells, values, report, unknown)
        else:
            values = cells.numbers(self.remarks)
        if self.remarks.has_faults:
            fault = self.remarks.first_fault
            self._why_not = f"is not numeric (line {fault.line}: {fault.what})"
            return
        self.cells.extend(math.nan if value is None else value for value in values)

    def why_left_out(self) -> str:
        """Why no pose gets this column; empty where they do. A column of the contract is always kept."""
        if self.name not in COLUMNS and not self._why_not and all(map(math.isnan, self.cells)):
            self._why_not = "has no values"
        return self._why_not


def _check(cells: Cells, values: Sequence[float | None], report: CsvReport, unknown: CsvReport) -> None:
    """Report what a column of the contract cannot hold, and what is blank in one that must not be."""
    name = cells.column.name
    if name in REQUIRED:
        cells.refuse(values, lambda value: value is None, "is not known, and a pose needs it", unknown)
    if name == "approach":
        cells.refuse(values, lambda value: value not in {None, -1.0, 0.0, 1.0}, "is none of -1, 0, 1", report)
    elif name in INTEGER:
        counts = [0.0 if value is None else value for value in values]
        cells.refuse(counts, lambda value: not (value or 0.0).is_integer(), "is not whole", report)
        whole = [0.0 if not value.is_integer() else value for value in counts]
        cells.refuse(whole, lambda value: not 0 <= (value or 0.0) <= MAX_COUNT, "is not a count", report)


AXIS = "mount_axis"
LABELS = ("unit", "mount", AXIS)
REFERENCE_STD, REFERENCE_KIND = "reference_std_deg", "reference_kind"
_KNOWN = (*COLUMNS, *OF_MOUNTS, "velocity_dps", HOST_TIME, *LABELS, REFERENCE_STD, REFERENCE_KIND)


@dataclass(frozen=True, slots=True)
class FileReference:
    """The reference that a file of poses states in its columns; `kind` is None if it has no such column."""

    std_deg: float
    kind: StatedKind | None


def read_run(
    data: bytes, unit: str, progress: Callable[[float], None] | None = None
) -> tuple[PoseColumns, str, list[str], FileReference | None]:
    """The poses of a file that is to be a run, in the order measured, and how they are clamped.

    A run is of one unit, has one of its axes along the stage's, and one clamping at each angle.

    `unit` is the serial number of the run's unit; `progress` gets the share of the file that is read, 0 to 1.

    Returns:
        The poses, the axis along the stage's, what is to be said, and the reference that the file states.

    Raises:
        CsvError: the file is no table of poses, or they are of several runs or references.
    """
    labels = (*LABELS, REFERENCE_STD, REFERENCE_KIND)
    poses, texts, warnings = read_labelled_columns(data, labels, progress)
    if "unit" in texts and (serial := _one(texts["unit"], "unit")) not in {unit, ""}:
        warnings.append(f"the file says that these poses are of unit {serial}")
    axis = _axis(texts[AXIS]) if AXIS in texts else "x"
    if "mount" in texts:
        _refuse_two_in_one(texts["mount"], poses.cells(MOUNT_DEG))
    poses, cut = poses.on_one_arc()
    ordered, of_time = poses.in_time()
    return ordered, axis, [*warnings, *of_time, *cut], _file_reference(texts)


def read_about_x(data: bytes) -> tuple[list[Pose], list[str]]:
    """The poses of a file that are one unit's, about its x, in the order measured, and what is to be said.

    Raises:
        CsvError: the file is no table of poses, or they are of several units or about another axis.
    """
    poses, texts, warnings = read_labelled_columns(data, ("unit", AXIS))
    if "unit" in texts:
        _one(texts["unit"], "unit")
    axis = _axis(texts[AXIS]) if AXIS in texts else "x"
    if axis != "x":
        raise CsvError(f"is {axis}, and this is of elevations about x; `calrig solve` takes it", column=AXIS)
    poses, cut = poses.on_one_arc()
    ordered, of_time = poses.in_time()
    return ordered[:], [*warnings, *of_time, *cut]


def _one(column: Texts, name: str) -> str:
    """The text of every cell; blank cells are of any."""
    first = next((text for text in column.texts if text), "")
    for text, line in zip(column.texts, column.lines, strict=True):
        if text not in {first, ""}:
            raise CsvError(f"{text!r} after {first!r}: {_ALONE}", line=line, column=name)
    return first


_ALONE = "make a file of each, and a run of each file, or solve the file as it is"


def _file_reference(texts: dict[str, Texts]) -> FileReference | None:
    """Return the reference that columns of the file state; None if their cells are all blank."""
    stds, kinds = (texts.get(name, Texts([], [])) for name in (REFERENCE_STD, REFERENCE_KIND))
    kinds = Texts([text.lower() for text in kinds.texts], kinds.lines)
    for text, line in zip(stds.texts, stds.lines, strict=True):
        if text and not 0.0 < float(text) <= MOST_REFERENCE_STD_DEG:
            said = f"{text} is not above 0 and at most {MOST_REFERENCE_STD_DEG:g}"
            raise CsvError(said, line=line, column=REFERENCE_STD)
    allowed = get_args(StatedKind)
    for text, line in zip(kinds.texts, kinds.lines, strict=True):
        if text not in (*allowed, ""):
            raise CsvError(f"{text!r} is none of {', '.join(allowed)}", line=line, column=REFERENCE_KIND)
    std, kind = _one(stds, REFERENCE_STD), _one(kinds, REFERENCE_KIND)
    if std:
        return FileReference(float(std), cast(StatedKind, kind) if kind else None)
    if kind:
        line = next(line for text, line in zip(kinds.texts, kinds.lines, strict=True) if text)
        said = f"states no uncertainty: add a column {REFERENCE_STD}"
        raise CsvError(said, line=line, column=REFERENCE_KIND)
    return None


def _axis(column: Texts) -> str:
    """What every pose has along the stage's axis; `x` where a cell is blank."""
    faces = [text.lower().removeprefix("+") or "x" for text in column.texts]
    for text, face, line in zip(column.texts, faces, column.lines, strict=True):
        if face not in FACES:
            raise CsvError(f"{text!r} is none of {', '.join(FACES)}", line=line, column=AXIS)
    return _one(Texts(faces, column.lines), AXIS) or "x"


def _refuse_two_in_one(mounts: Texts, angles: Sequence[float | None] | None) -> None:
    """Raises CsvError where one label is at two angles, or two are at one: a run tells them by the angle."""
    at: dict[str, float | None] = {}
    named: dict[float | None, str] = {}
    for place, (mount, line) in enumerate(zip(mounts.texts, mounts.lines, strict=True)):
        if not mount:
            continue
        angle = None if angles is None else angles[place]
        if at.setdefault(mount, angle) != angle:
            said = f"{mount!r} was clamped at {_degrees(at[mount])} and at {_degrees(angle)}"
            raise CsvError(f"{said}: give what was clamped anew a name of its own", line=line, column="mount")
        if (other := named.setdefault(angle, mount)) != mount:
            said = f"{mount!r} and {other!r} are two clampings at {_degrees(angle)}"
            raise CsvError(f"{said}: {_ALONE}", line=line, column="mount")


def _degrees(angle: float | None) -> str:
    return "no stated angle" if angle is None else f"{angle:g}°"


def read_mounted(data: bytes, source: str, unit: str | None) -> tuple[list[MountedPoses], list[str]]:
    """The poses of a file, a lot for each clamping.

    `source` is what the file is called, `unit` the serial number of its poses where it has no column `unit`.

    Raises:
        CsvError: the file is no table of poses, or does not say of every pose whose it is.
    """
    poses, texts, warnings = read_labelled_columns(data, LABELS)
    order, of_time = poses.order_in_time()
    labels = [{name: cells.texts[k] for name, cells in texts.items() if cells.texts[k]} for k in order]
    lots, cuts = _by_mounting(poses.in_time()[0][:], labels, source, unit), []
    for place, lot in enumerate(lots):
        targets, cut = _on_one_arc(*np.array([(pose.target_deg, pose.reading_deg) for pose in lot.poses]).T)
        if cut:
            own = [replace(pose, target_deg=to) for pose, to in zip(lot.poses, targets.tolist(), strict=True)]
            lots[place] = replace(lot, poses=own)
            cuts += [f"unit {lot.unit}, mount {lot.mount}: {cut[0]}"]
    return lots, [*warnings, *of_time, *cuts]


def _by_mounting(
    poses: Sequence[Pose], labels: Sequence[Labels], source: str, unit: str | None
) -> list[MountedPoses]:
    """Poses by clamping; without a label a mount is called by its source, and its angle if it has one."""
    lots: dict[tuple[str, str, float | None, str], list[Pose]] = {}
    for pose, texts in zip(poses, labels, strict=True):
        serial, angle = texts.get("unit", unit), pose.covariates.get(MOUNT_DEG)
        if serial is None:
            whose = (
                f"the pose at target_deg {pose.target_deg:g} has no unit"
                if lots
                else "it is not said whose poses these are"
            )
            raise CsvError(f"{whose}: give it a column unit, or --unit", column="unit")
        axis = texts.get(AXIS, "x")
        name = texts.get("mount") or _name(source, angle, axis)
        bare = replace(pose, covariates={k: v for k, v in pose.covariates.items() if k != MOUNT_DEG})
        lots.setdefault((serial, name, angle, axis), []).append(bare)
    return [
        MountedPoses(serial, name, angle, source, own, axis)
        for (serial, name, angle, axis), own in lots.items()
    ]


def _name(source: str, angle: float | None, axis: str) -> str:
    """Of a mount without a label."""
    words = [source, "" if angle is None else f"{angle:g}°", "" if axis.lstrip("+") == "x" else axis]
    return " ".join(word for word in words if word)
