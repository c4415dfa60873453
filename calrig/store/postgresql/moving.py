"""PostgreSQL as source or target of a move: connected clients, COPY, values that no row may hold."""

import json
from collections.abc import Sequence
from typing import Any, NoReturn

import psycopg
from sqlalchemy import BigInteger, Connection, Integer, Table, text

from calrig.store.checksums import CheckedJson
from calrig.store.database import Database
from calrig.store.errors import Refused
from calrig.store.postgresql.connection import driver_of, wait_long
from calrig.store.postgresql.errors import store_error
from calrig.store.raw_rows import TEXTS, Row, names, row_name

LARGEST = 2**31 - 1
"""Of the columns that are whole numbers."""
_OTHERS = """
SELECT coalesce(host(client_addr), 'this machine'), to_char(backend_start, 'YYYY-MM-DD"T"HH24:MI:SSOF')
FROM pg_stat_activity
WHERE datname = current_database() AND application_name = 'calrig' AND pid <> pg_backend_pid()
ORDER BY backend_start LIMIT 1
"""


class PostgresqlEnd:
    """A database that a store is moved out of, or into."""

    def __init__(self, database: Database) -> None:
        self._name = database.name

    def other_writer(self, connection: Connection) -> str | None:
        """Which program has it open as well, in words; None where none has."""
        found = connection.execute(text(_OTHERS)).first()
        return None if found is None else f"another calrig (connected from {found[0]} since {found[1]})"

    def begin(self, connection: Connection, tables: Sequence[Table]) -> None:
        """Makes ready for rows: nobody is told of events that are years old."""
        wait_long(connection)
        # between two statements it reads the source
        connection.execute(text("SET LOCAL idle_in_transaction_session_timeout = 0"))
        self._each(connection, tables, "ALTER TABLE {} DISABLE TRIGGER USER")

    def lay(self, connection: Connection, table: Table, rows: Sequence[Row]) -> None:
        """Adds rows whose values are as `calrig.store.raw_rows.pieces` gives them.

        Raises:
            Refused: names a row that PostgreSQL cannot keep, and why.
        """
        self._refuse_what_is_not_kept(table, rows)
        named = connection.dialect.identifier_preparer.format_table(table)
        command = f"COPY {named} ({names(connection, table)}) FROM STDIN"
        try:
            with driver_of(connection).cursor() as cursor, cursor.copy(command.encode()) as copy:
                for row in rows:
                    copy.write_row(row)
        except psycopg.Error as error:
            raise store_error(error, self._name) from error

    def end(self, connection: Connection, tables: Sequence[Table]) -> None:
        """Has the next rows be numbered after those that were laid."""
        self._each(connection, tables, "ALTER TABLE {} ENABLE TRIGGER USER")
        quote = connection.dialect.identifier_preparer.quote
        for table in tables:
            column = table.autoincrement_column
            if column is None:
                continue
            named = connection.dialect.identifier_preparer.format_table(table)
            last = f"SELECT max({quote(column.name)}) FROM {named}"  # noqa: S608
            sequence = "pg_get_serial_sequence(:named, :column)"
            used = f"FROM ({last}) AS largest (last) WHERE last > 0"  # limits begin at 0, and name their own
            wanted = text(f"SELECT setval({sequence}, last) {used}")
            connection.execute(wanted, {"named": named, "column": column.name})

    def _each(self, connection: Connection, tables: Sequence[Table], command: str) -> None:
        for table in tables:
            connection.execute(
                text(command.format(connection.dialect.identifier_preparer.format_table(table)))
            )

    def _refuse_what_is_not_kept(self, table: Table, rows: Sequence[Row]) -> None:
        for column, values in zip(table.columns, zip(*rows, strict=True), strict=True):
            if isinstance(column.type, CheckedJson):
                wrong, why = _first(values, _has_no_number), "NaN or an infinity, which is no JSON"
            elif isinstance(column.type, Integer) and not isinstance(column.type, BigInteger):
                wrong, why = (
                    _first(values, lambda n: not -LARGEST <= n <= LARGEST),
                    f"a number beyond ±{LARGEST}",
                )
            elif isinstance(column.type, TEXTS):
                wrong, why = _first(values, lambda value: "\0" in value), "text with a NUL character in it"
            else:
                continue
            if wrong is not None:
                raise Refused(
                    f"{self._name}: {column.name!r} of {row_name(table, rows[wrong])} is {why}: "
                    "PostgreSQL does not keep it, so nothing was moved"
                )


def _first(values: Sequence[Any], is_wrong: Any) -> int | None:
    return next((k for k, value in enumerate(values) if value is not None and is_wrong(value)), None)


def _has_no_number(value: str) -> bool:
    """Of JSON text; only stores from before the checksums can have one."""
    if "NaN" not in value and "Infinity" not in value:
        return False

    def refuse(name: str) -> NoReturn:
        raise ValueError(name)

    try:
        json.loads(value, parse_constant=refuse)
    except ValueError:
        return True
    return False
