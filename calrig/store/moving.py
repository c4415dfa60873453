"""A whole store taken over into an empty one, on whichever engines, and proven to be the same."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from sqlalchemy import Connection, Table, text
from sqlmodel import Session

from calrig.store.database import BUSY_TIMEOUT_S, Database
from calrig.store.engines import is_centre, open_database
from calrig.store.errors import Refused, StoreDamagedError
from calrig.store.raw_rows import Row, TableHash, count, pieces, tables
from calrig.store.records import UNFINISHED
from calrig.store.stored_checksums import RowChecks

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

    Args:
        source_url: of the store to move, as `calrig.store.Store.open` takes it.
        target_url: of the empty one; it is made where there is none.
        told: is told the share done, 0 to 1.

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
    from calrig.store.sqlite.moving import SqliteEnd

    return SqliteEnd(database)


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
