"""Copy a whole store into an empty one, on either engine, and prove that both are equal.

The checksums of all rows are verified before anything is copied.
"""

import time
import zlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol, get_args

from sqlalchemy import Connection, Table, text
from sqlalchemy.engine.interfaces import Dialect
from sqlmodel import Session

from calrig.canonical_json import sha256_of
from calrig.model.run import UNFINISHED
from calrig.store import checksums
from calrig.store.certificates import Form, check_bytes
from calrig.store.convert import FIGURES, POSE_NUMBERS, unpacked_block
from calrig.store.database import BUSY_TIMEOUT_S, Database
from calrig.store.engines import is_centre, open_database
from calrig.store.errors import Refused, StoreDamagedError, Unreadable
from calrig.store.raw_rows import Row, TableHash, count, names, pieces, row_name, tables
from calrig.store.sqlite.database import SqliteDatabase
from calrig.store.sqlite.lock import living_writer
from calrig.store.tables import UtcText
from calrig.store.trail import FIRST, chained

_Checked = dict[str, Any]
"""A row by name of column; documents and times as the tables' own types read them."""


class RowChecks:
    """Checks the rows of one table, piece by piece in the order of its key.

    `connection` is where the rows come from: for poses, which are counted with their runs.
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
            "certificate": _check_certificate,
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


def _check_certificate(certificate: _Checked) -> None:
    for form in get_args(Form):
        check_bytes(certificate["number"], form, certificate[form], certificate["sha256"])


READINGS = 3
"""Every row is read to be moved, and once more at either end to be compared."""


@dataclass(frozen=True, slots=True)
class MovedTable:
    """A table that is the same at both ends: its rows, and the hash as `calrig.store.raw_rows` defines it."""

    name: str
    rows: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Moved:
    """What was moved, in the order in which tables refer to one another; `says` is what to know of it."""

    tables: tuple[MovedTable, ...]
    duration_s: float
    says: tuple[str, ...]


class _End(Protocol):
    """What an engine does in its own way."""

    def other_writer(self, connection: Connection) -> str | None: ...
    def begin(self, connection: Connection, tables: Sequence[Table]) -> None: ...
    def lay(self, connection: Connection, table: Table, rows: Sequence[Row]) -> None: ...
    def end(self, connection: Connection, tables: Sequence[Table]) -> None: ...


def move_store(source_url: str, target_url: str, told: Callable[[float], None] = lambda _: None) -> Moved:
    """Copies every row of one store into another, which is empty, and compares the two.

    The source is read as it is at one instant and not changed. The target has all of it or, where anything
    goes wrong, none.

    `source_url` is as `calrig.store.Store.open` takes it; the target is made where there is none. `told` is
    told the share done, 0 to 1.

    Raises:
        StoreDamagedError: something in the source is not what was stored; names it.
        StoreError: either cannot be used; the source is older, or runs are carried out in it now; the target
            has something in it, or cannot keep what the source has.
    """
    begun_s = time.monotonic()
    source = open_database(source_url, None, BUSY_TIMEOUT_S, lambda _: None)
    try:
        from_end = _end_of(source_url, source)
        with source.reading() as session:
            says = _look_for_runs(source, from_end, session)
        target = open_database(target_url, "move-store", BUSY_TIMEOUT_S, lambda _: None)
        try:
            to_end = _end_of(target_url, target)
            # the source within the target: what the source has to say at its end undoes the move
            with target.writing() as there, source.reading() as here:
                moved = _Move(source, target, here.connection(), there.connection(), told).carry_out(to_end)
        finally:
            target.close()
    finally:
        source.close()
    return Moved(moved, time.monotonic() - begun_s, says)


def _end_of(url: str, database: Database) -> _End:
    if is_centre(url):
        from calrig.store.postgresql.moving import PostgresqlEnd

        return PostgresqlEnd(database)
    return _SqliteEnd(database)


class _SqliteEnd:
    """A file that a store is moved out of, or into."""

    def __init__(self, database: Database) -> None:
        assert isinstance(database, SqliteDatabase)  # noqa: S101 (as its URL says)
        self._path = database.path

    def other_writer(self, connection: Connection) -> str | None:  # noqa: ARG002
        """Which program writes to it now, in words; None where none does."""
        return living_writer(self._path)

    def begin(self, connection: Connection, tables: Sequence[Table]) -> None:
        """Makes ready for rows; nothing is to be done."""

    def lay(self, connection: Connection, table: Table, rows: Sequence[Row]) -> None:
        """Adds rows whose values are as `calrig.store.raw_rows.pieces` gives them."""
        marks = ", ".join("?" * len(table.columns))
        named = connection.dialect.identifier_preparer.format_table(table)
        insert = f"INSERT INTO {named} ({names(connection, table)}) VALUES ({marks})"  # noqa: S608
        connection.exec_driver_sql(insert, list(rows))

    def end(self, connection: Connection, tables: Sequence[Table]) -> None:
        """What is left to do once all rows are there: the next number follows the largest by itself."""


def _look_for_runs(source: Database, end: _End, session: Session) -> tuple[str, ...]:
    """Refuses a source in which runs go on; what else is to be known of those that were left."""
    connection = session.connection()
    marks = ", ".join(f"'{status}'" for status in UNFINISHED)
    wanted = f"SELECT uid FROM run WHERE status IN ({marks}) ORDER BY id"  # noqa: S608
    unfinished = list(connection.execute(text(wanted)).scalars())
    writer = end.other_writer(connection)
    if unfinished and writer is not None:
        more = f" and {len(unfinished) - 1} more" if len(unfinished) > 1 else ""
        raise Refused(
            f"{source.name}: {writer} carries out run {unfinished[0]}{more}: let it end, or stop that program"
        )
    said = []
    if unfinished:
        named = ", ".join(unfinished[:3])
        said.append(f"{len(unfinished)} runs have no end and nobody carries them out ({named})")
    if writer is not None:
        said.append(f"{writer} has {source.name} open: what it stores from now on is not taken over")
    return tuple(said)


class _Move:
    """The rows of a source on their way to a target, inside a transaction at each."""

    def __init__(
        self,
        source: Database,
        target: Database,
        here: Connection,
        there: Connection,
        told: Callable[[float], None],
    ) -> None:
        self._source, self._target = source, target
        self._here, self._there = here, there
        self._tables = tables()
        self._rows = {table.name: count(here, table) for table in self._tables}
        self._told = told
        self._read = 0

    def carry_out(self, end: _End) -> tuple[MovedTable, ...]:
        with self._of_target():
            self._refuse_what_is_not_empty()
            end.begin(self._there, self._tables)
        for table in self._tables:
            checks = RowChecks(self._here, table)
            for rows in pieces(self._here, table):
                checks.check(rows)
                with self._of_target():
                    end.lay(self._there, table, rows)
                self._tell(rows)
        compared = tuple(self._compared(table) for table in self._tables)
        with self._of_target():
            end.end(self._there, self._tables)
        return compared

    def _of_target(self) -> AbstractContextManager[None]:
        """What goes wrong in here is the target's: the source's own words are around all of it."""
        return self._target._in_words()

    def _refuse_what_is_not_empty(self) -> None:
        found = {table.name: count(self._there, table) for table in self._tables}
        named = ", ".join(f"{n} rows in {name!r}" for name, n in found.items() if n)
        if named:
            raise Refused(
                f"{self._target.name}: is not empty ({named}): name an empty one; nothing was moved"
            )

    def _compared(self, table: Table) -> MovedTable:
        here = self._hash(self._here, table)
        with self._of_target():
            there = self._hash(self._there, table)
        if here != there:
            raise StoreDamagedError(
                f"{self._target.name}: table {table.name!r} came out as something else than in "
                f"{self._source.name} (SHA-256 {there[:16]}… for {here[:16]}…); nothing was moved"
            )
        return MovedTable(table.name, self._rows[table.name], here)

    def _hash(self, connection: Connection, table: Table) -> str:
        found = TableHash(table)
        for rows in pieces(connection, table):
            found.update(rows)
            self._tell(rows)
        return found.hexdigest()

    def _tell(self, rows: Sequence[Row]) -> None:
        self._read += len(rows)
        self._told(self._read / max(1, READINGS * sum(self._rows.values())))
