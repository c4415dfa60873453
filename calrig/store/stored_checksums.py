"""Every checksum that is stored, held against rows as they lie: whoever moves a store proves it first."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from typing import Any

from sqlalchemy import Connection, Table
from sqlalchemy.engine.interfaces import Dialect

from calrig.canonical_json import sha256_of
from calrig.store import checksums
from calrig.store.column_types import UtcText
from calrig.store.convert import FIGURES, POSE_NUMBERS, unpacked_block
from calrig.store.errors import Unreadable
from calrig.store.raw_rows import Row, row_name
from calrig.store.trail import FIRST, chained

_Checked = dict[str, Any]
"""A row by name of column; documents and times as the tables' own types read them."""


class RowChecks:
    """Checks the rows of one table, piece by piece in the order of its key.

    Args:
        connection: where the rows come from: for poses, which are counted with their runs.
        table: theirs.
    """

    def __init__(self, connection: Connection, table: Table) -> None:
        self._connection = connection
        self._table = table
        self._dialect = connection.dialect
        self._decoded = [c for c in table.columns if isinstance(c.type, checksums.CheckedJson | UtcText)]
        self._names = [column.name for column in table.columns]
        checks: dict[str, Callable[[_Checked], None]] = {
            "pose": _check_pose,
            "calibration": _check_figures,
            "sample_block": _check_samples,
            "transcript": _check_transcript,
            "issued_calibration": _check_issued,
            "trail": self._check_link,
            "event": self._check_order,
        }
        self._check = checks.get(table.name)
        self._before = FIRST, 0
        self._last_event = (0, 0)

    def check(self, rows: Sequence[Row]) -> None:
        """Checks the rows that follow.

        Raises:
            Unreadable: names the first that is not what was stored.
        """
        checked = [self._check_row(row) for row in rows]
        if self._table.name == "run" and checked:
            self._count_poses(checked)

    def _check_row(self, row: Row) -> _Checked:
        values = dict(zip(self._names, row, strict=True))
        try:
            for column in self._decoded:
                values[column.name] = _decoded(column.type, values[column.name], self._dialect)
            if self._check is not None:
                self._check(values)
        except Unreadable as error:
            raise Unreadable(f"{row_name(self._table, row)}{self._run_of(values)}: {error}") from error
        return values

    def _run_of(self, values: _Checked) -> str:
        """The id that people know a row's run by."""
        number = values.get("run_id")
        if not isinstance(number, int):
            return ""
        wanted = f"SELECT uid FROM run WHERE id = {number}"  # noqa: S608
        uid = self._connection.exec_driver_sql(wanted).scalar()
        return f" (run {uid})"

    def _check_link(self, entry: _Checked) -> None:
        before, number = self._before
        said = [entry[name] for name in self._names if name != "sha256"]
        if entry["seq"] != number + 1 or entry["sha256"] != chained(before, said):
            raise Unreadable("the trail is broken here: it is not what was written after the entry before")
        self._before = entry["sha256"], entry["seq"]

    def _check_order(self, event: _Checked) -> None:
        run_id, number = self._last_event
        expected = number + 1 if event["run_id"] == run_id else 1
        if event["seq"] != expected:
            raise Unreadable(f"event {expected} of this run is missing")
        self._last_event = event["run_id"], event["seq"]

    def _count_poses(self, runs: Sequence[_Checked]) -> None:
        """Poses are stored in one transaction with their number."""
        first, last = runs[0]["id"], runs[-1]["id"]
        counted = self._connection.exec_driver_sql(
            "SELECT run_id, count(*) FROM pose "  # noqa: S608
            f"WHERE run_id BETWEEN {first} AND {last} GROUP BY run_id"
        )
        stored: dict[int, int] = {run_id: n for run_id, n in counted}  # noqa: C416 (rows, not pairs, to mypy)
        for run in runs:
            try:
                missing = int(run["progress"].get("poses_done", 0)) - stored.get(run["id"], 0)
            except (TypeError, ValueError, OverflowError) as error:
                raise Unreadable(f"progress of run {run['uid']} is not what was stored: {error}") from error
            if missing > 0:
                raise Unreadable(f"{missing} poses of run {run['uid']} are missing")


def _decoded(kind: Any, value: str | None, dialect: Dialect) -> Any:
    if value is not None and isinstance(kind, checksums.CheckedJson):
        return kind.process_result_value(checksums.from_json(value), dialect)
    return kind.process_result_value(value, dialect)


def _check_pose(pose: _Checked) -> None:
    numbers = (pose["run_id"], pose["pose_index"], *(pose[name] for name in POSE_NUMBERS))
    checksums.check_numbers(pose["crc32"], numbers, f"pose {pose['pose_index']}")


def _check_figures(figures: _Checked) -> None:
    checksums.check_numbers(figures["crc32"], (figures[name] for name in FIGURES), "the figures")


def _check_samples(block: _Checked) -> None:
    n_samples = len(unpacked_block(block["data"]))
    if n_samples != block["n_samples"]:
        raise Unreadable(f"there are {n_samples} raw samples, and were {block['n_samples']}")


def _check_transcript(transcript: _Checked) -> None:
    try:
        zlib.decompress(transcript["data"]).decode()
    except (zlib.error, UnicodeDecodeError) as error:
        raise Unreadable(f"it cannot be unpacked any more: {error}") from error


def _check_issued(issued: _Checked) -> None:
    document = checksums.from_json(issued["document"])
    try:
        sha256 = sha256_of(document)
    except (ValueError, AttributeError) as error:
        raise Unreadable(f"it is no document any more: {error}") from error
    if {sha256, document.get("sha256")} != {issued["sha256"]}:
        raise Unreadable("it is not what was issued")
