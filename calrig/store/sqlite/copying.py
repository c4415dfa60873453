"""A copy of a store: complete and sound, or not there."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from pathlib import Path

from calrig.store.database import BUSY_TIMEOUT_S
from calrig.store.errors import StoreError
from calrig.store.sqlite import file_system
from calrig.store.sqlite.connecting import connect
from calrig.store.sqlite.errors import damaged, store_error

PAGES_AT_ONCE = 2000
"""Eight megabytes: between two such pieces Ctrl-C is heard."""


def copy_database(database: Path, target: Path) -> None:
    """Copies a SQLite file as it is at one instant to a file that does not exist yet; checks the copy.

    Raises:
        StoreError: `target` exists or cannot be written, or `database` cannot be read or is damaged; nothing
            is left behind.
    """
    unfinished = target.with_name(f"{target.name}.unfinished")
    if os.path.lexists(target):
        raise StoreError(f"{target}: exists and is not overwritten: name another file")
    try:
        unfinished.unlink(missing_ok=True)  # of a copy that was killed
        file_system.make_private(unfinished)
        _copy(database, unfinished, target)
        _sync(unfinished)
        if os.path.lexists(target):
            raise StoreError(f"{target}: exists and is not overwritten: name another file")
        unfinished.replace(target)
        _sync(target.parent)
    except OSError as error:
        raise store_error(error, target) from error
    finally:
        with contextlib.suppress(OSError):  # the first error is the one to tell
            unfinished.unlink(missing_ok=True)


def _copy(database: Path, unfinished: Path, target: Path) -> None:
    uri = file_system.reading_uri(database, BUSY_TIMEOUT_S)
    with (
        contextlib.closing(connect(uri, BUSY_TIMEOUT_S)) as source,
        contextlib.closing(_new(unfinished, target)) as copy,
    ):
        try:
            # One read transaction around all pieces: the writer goes on, and the copy need not begin again.
            source.execute("BEGIN")
            source.execute("SELECT count(*) FROM sqlite_master").fetchone()
            source.backup(copy, pages=PAGES_AT_ONCE)
            source.execute("ROLLBACK")
            copy.execute("PRAGMA journal_mode = DELETE")  # one file, to be read wherever it is put
        except sqlite3.Error as error:
            raise store_error(error, _at_fault(error, database, target)) from error
        check_sound(copy, database)


def _new(file: Path, target: Path) -> sqlite3.Connection:
    try:
        connection = connect(file)
        connection.execute("PRAGMA journal_mode = OFF")  # it is thrown away where it is not completed
        connection.execute("PRAGMA synchronous = OFF")  # and synced once, whole
    except sqlite3.Error as error:
        raise store_error(error, target) from error
    return connection


def _at_fault(error: sqlite3.Error, source: Path, target: Path) -> Path:
    """Which of the two files an error of the copying is about: SQLite does not say."""
    of_writing = ("SQLITE_FULL", "SQLITE_IOERR_WRITE", "SQLITE_READONLY", "SQLITE_IOERR_FSYNC")
    return target if (error.sqlite_errorname or "").startswith(of_writing) else source


def check_sound(connection: sqlite3.Connection, database: Path) -> None:
    """Looks at every page of a file.

    Raises:
        StoreDamagedError: one of them is not what SQLite wrote.
    """
    try:
        (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.Error as error:
        raise store_error(error, database) from error
    if found != "ok":
        raise damaged(database, " ".join(found.split()))


def _sync(path: Path) -> None:
    """Has the disk keep a file, or the names in a folder."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
