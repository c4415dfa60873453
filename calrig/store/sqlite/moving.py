"""SQLite as source or target of a move: the writer of the file, and rows inserted unchanged."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, Table

from calrig.store.database import Database
from calrig.store.raw_rows import Row, names
from calrig.store.sqlite.database import SqliteDatabase
from calrig.store.sqlite.lock import living_writer


class SqliteEnd:
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
