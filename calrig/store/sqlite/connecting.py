"""Connections to a file that somebody else may have had a hand in: its schema runs nothing of theirs."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

from calrig.store.errors import StoreError
from calrig.store.sqlite.errors import store_error

MOST_NAMED = 5
IS_VIRTUAL = "(type = 'table' AND rootpage = 0)"


def connect(where: str | Path, timeout_s: float = 5.0, **options: Any) -> sqlite3.Connection:
    """A connection whose schema may call no function that does more than compute.

    https://www.sqlite.org/security.html, "Untrusted SQLite database files".

    Args:
        where: the file's path, or a URI.
        timeout_s: how long to wait for another connection's lock.
        options: as `sqlite3.connect` takes them.
    """
    is_uri = isinstance(where, str)
    connection: sqlite3.Connection = sqlite3.connect(where, timeout=timeout_s, uri=is_uri, **options)
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")
    return connection


def refuse_foreign(connection: sqlite3.Connection, database: Path) -> None:
    """Looks for what would act or compute by itself; calrig makes tables and indexes only.

    Raises:
        StoreError: there are triggers, views or virtual tables; names them.
    """
    wanted = f"SELECT type, name FROM sqlite_master WHERE type IN ('trigger', 'view') OR {IS_VIRTUAL}"  # noqa: S608
    try:
        found = connection.execute(wanted).fetchall()
    except sqlite3.Error as error:
        raise store_error(error, database) from error
    if not found:
        return
    named = [f"{'virtual table' if kind == 'table' else kind} {name[:60]!a}" for kind, name in found]
    more = [f"and {len(named) - MOST_NAMED} more"] if len(named) > MOST_NAMED else []
    raise StoreError(
        f"{database}: holds what calrig did not make and what would act by itself "
        f"({', '.join(named[:MOST_NAMED] + more)}); nothing was changed: go back to a backup "
        "(`calrig backup`), or remove it with SQLite's own DROP if you know who put it there"
    )


def is_a_table(connection: sqlite3.Connection, name: str) -> bool:
    """Whether it is one that is stored, and not a view of that name."""
    wanted = f"SELECT 1 FROM sqlite_master WHERE name = ? AND type = 'table' AND NOT {IS_VIRTUAL}"  # noqa: S608
    return connection.execute(wanted, (name,)).fetchone() is not None
