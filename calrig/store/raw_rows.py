"""Raw rows of the tables on either engine, with a hash of a table that is equal on both.

The hash is the SHA-256 of UTF-8 lines ended by LF: the names of the columns, then the rows in key order, each
a JSON array without blanks. A document is its stored text, bytes are their SHA-256 in hexadecimal, and a zero
has no sign, because SQLite stores none.
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Boolean, Column, Connection, Float, Integer, LargeBinary, String, Table
from sqlmodel import AutoString, SQLModel

# their tables belong to the metadata
from calrig.store import bench_tables  # noqa: F401
from calrig.store.checksums import CheckedJson
from calrig.store.errors import Unreadable
from calrig.store.tables import UtcText

Row = tuple[Any, ...]
ROWS_AT_ONCE = 1000
WIDE_ROWS_AT_ONCE = 20
"""Of tables with bytes in them: a block of a static log has some megabytes."""
TEXTS = (String, AutoString, UtcText)
"""Types of columns that hold text and no document."""
_STREAMED = {"stream_results": True}
_line = json.JSONEncoder(ensure_ascii=False, separators=(",", ":")).encode


def tables() -> list[Table]:
    """Every table, those that others refer to first."""
    return list(SQLModel.metadata.sorted_tables)


def names(connection: Connection, table: Table) -> str:
    """The columns of a table in its order, as SQL has them."""
    quote = connection.dialect.identifier_preparer.quote
    return ", ".join(quote(column.name) for column in table.columns)


def count(connection: Connection, table: Table) -> int:
    """How many rows a table has."""
    named = connection.dialect.identifier_preparer.format_table(table)
    return int(connection.exec_driver_sql(f"SELECT count(*) FROM {named}").scalar_one())  # noqa: S608


def pieces(connection: Connection, table: Table) -> Iterator[list[Row]]:
    """The rows of a table in the order of its key, some at a time, none of them decoded or made up for.

    Raises:
        Unreadable: a value is none of its column's kind: SQLite keeps anything in any column.
    """
    are_wide = any(isinstance(column.type, LargeBinary) for column in table.columns)
    at_once = WIDE_ROWS_AT_ONCE if are_wide else ROWS_AT_ONCE
    options = {**_STREAMED, "yield_per": at_once}
    with connection.exec_driver_sql(_select(connection, table), None, options) as result:
        for piece in result.partitions(at_once):
            columns = zip(*piece, strict=True)
            checked = [
                _as_kept(table, column, values, piece)
                for column, values in zip(table.columns, columns, strict=True)
            ]
            yield list(zip(*checked, strict=True))


def _select(connection: Connection, table: Table) -> str:
    """Raw: a document comes as its text, and text is ordered by its bytes."""
    preparer = connection.dialect.identifier_preparer
    is_server = connection.dialect.name == "postgresql"
    wanted, order = [], []
    for column in table.columns:
        name = preparer.quote(column.name)
        is_document = isinstance(column.type, CheckedJson)
        wanted.append(f"CAST({name} AS TEXT)" if is_server and is_document else name)
    for column in table.primary_key:
        is_text = is_server and isinstance(column.type, TEXTS)
        order.append(preparer.quote(column.name) + (' COLLATE "C"' if is_text else ""))
    named = preparer.format_table(table)
    return f"SELECT {', '.join(wanted)} FROM {named} ORDER BY {', '.join(order)}"  # noqa: S608


@dataclass(frozen=True, slots=True)
class _Kind:
    """What a column's values are as a driver gives them, and as they are compared."""

    of: frozenset[type]
    words: str
    kept: Callable[[Any], Any] | None = None


def _number(value: float) -> float:
    if math.isnan(value):
        raise ValueError("it is not a number, and what is not known is null")
    return value + 0.0  # a zero loses its sign


_NOTHING = type(None)
_KINDS: tuple[tuple[type | tuple[type, ...], _Kind], ...] = (
    (Boolean, _Kind(frozenset({bool, int, _NOTHING}), "truth", bool)),
    (Float, _Kind(frozenset({float, _NOTHING}), "number", _number)),
    (Integer, _Kind(frozenset({int, _NOTHING}), "whole number")),
    (LargeBinary, _Kind(frozenset({bytes, _NOTHING}), "bytes")),
    ((*TEXTS, CheckedJson), _Kind(frozenset({str, _NOTHING}), "text")),
)


def _as_kept(
    table: Table, column: Column[Any], values: Sequence[Any], piece: Sequence[Sequence[Any]]
) -> Sequence[Any]:
    """A column of a piece, as every engine keeps it."""
    kind = next(kind for types, kind in _KINDS if isinstance(column.type, types))
    if not kind.of.issuperset(map(type, values)):
        at = next(k for k, value in enumerate(values) if type(value) not in kind.of)
        raise Unreadable(
            f"{row_name(table, piece[at])} is not what was stored: "
            f"there is no {kind.words} in {column.name!r} where one belongs"
        )
    if kind.kept is None:
        return values
    kept = []
    for at, value in enumerate(values):
        try:
            kept.append(None if value is None else kind.kept(value))
        except ValueError as error:
            raise Unreadable(f"{column.name!r} of {row_name(table, piece[at])}: {error}") from error
    return kept


def row_name(table: Table, row: Sequence[Any]) -> str:
    """What messages call a row: its table and its key."""
    key = (
        f"{column.name} {value!r}"
        for column, value in zip(table.columns, row, strict=True)
        if column.primary_key
    )
    return f"the row of {table.name!r} with {', '.join(key)}"


class TableHash:
    """The hash of a table, of its rows as `pieces` gives them."""

    def __init__(self, table: Table) -> None:
        self._hash = hashlib.sha256()
        self._bytes_at = [k for k, c in enumerate(table.columns) if isinstance(c.type, LargeBinary)]
        self._add([column.name for column in table.columns])

    def update(self, rows: Iterable[Row]) -> None:
        """Adds rows."""
        for row in rows:
            values = list(row)
            for k in self._bytes_at:
                if values[k] is not None:
                    values[k] = hashlib.sha256(values[k]).hexdigest()
            self._add(values)

    def _add(self, values: list[Any]) -> None:
        self._hash.update(f"{_line(values)}\n".encode())

    def hexdigest(self) -> str:
        """The hash so far."""
        return self._hash.hexdigest()
