"""Copy a store completely and verified, or not at all; migrate a file after a copy of it is stored."""

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from calrig.store.database import BUSY_TIMEOUT_S, migrate, revisions
from calrig.store.errors import StoreError
from calrig.store.sqlite import file as file_system
from calrig.store.sqlite.errors import damaged, store_error
from calrig.store.sqlite.file import connect, refuse_foreign

PAGES_AT_ONCE = 2000
"""Eight megabytes: between two such pieces Ctrl-C is heard."""


def copy_database(database: Path, target: Path) -> None:
    """Copies a SQLite file as it is at one instant to a file that does not exist yet; checks the copy.

    Raises:
        StoreError: `target` exists or cannot be written, or `database` cannot be read or is damaged; nothing
            is left behind.
    """
    _refuse_to_overwrite(target)
    with _unfinished(target) as unfinished:
        _copy(database, unfinished, target)
        _sync(unfinished)
        _refuse_to_overwrite(target)


def _refuse_to_overwrite(target: Path) -> None:
    if os.path.lexists(target):
        raise StoreError(f"{target}: exists and is not overwritten: name another file")


@contextlib.contextmanager
def _unfinished(target: Path) -> Iterator[Path]:
    """Yield a private file that takes the target's place when the block ends well, and is gone otherwise."""
    unfinished = target.with_name(f"{target.name}.unfinished")
    try:
        unfinished.unlink(missing_ok=True)  # of a program that was killed
        file_system.make_private(unfinished)
        yield unfinished
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


def stored_revision(database: Path, uri: str | None = None) -> str | None:
    """The revision of a database file; None where it is empty.

    `uri` opens it for reading only, as `calrig.store.sqlite.file.reading_uri` says.

    Raises:
        StoreError: it cannot be read, is not SQLite, is another program's, or holds what would act by itself.
    """
    try:
        with contextlib.closing(connect(uri or database)) as connection:
            tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
            if not tables:
                return None
            if "alembic_version" in tables and "calibration" in tables:
                refuse_foreign(connection, database)
                row = connection.execute("SELECT version_num FROM alembic_version").fetchone()
                if row:
                    return str(row[0])
    except sqlite3.Error as error:
        raise store_error(error, database) from error
    except UnicodeDecodeError as error:  # of SQLite's own message, with a table's broken name in it
        raise damaged(database, str(error)) from error
    raise StoreError(f"{database}: is another program's database: name another file with --db")


def check_not_newer(database: Path, stored: str | None) -> None:
    """Refuses a database that a newer calrig has written.

    Raises:
        StoreError: says where the copies are that were kept before.
    """
    head = revisions()[-1]
    if stored is None or stored in revisions():
        return
    copies = sorted(str(copy) for copy in database.parent.glob(f"{database.name}.before-*.bak"))
    use_copy = (
        f", or name a copy kept before it was brought up to date ({', '.join(copies)})" if copies else ""
    )
    raise StoreError(
        f"{database}: was written by a newer calrig (revision {stored}; this one knows up to {head}); "
        f"nothing was changed: install the newer calrig{use_copy}"
    )


def make_new(database: Path) -> None:
    """Makes an empty store where there is none; its file is there only once it is complete.

    Raises:
        StoreError: it cannot be made; nothing is left behind.
    """
    with _unfinished(database) as unfinished:
        upgrade(unfinished, None)


def upgrade(database: Path, stored: str | None) -> None:
    """Brings the database to the program's revision, all of it or nothing, after a copy was kept.

    Raises:
        StoreError: the copy or the migration failed; the database is as it was.
    """
    head = revisions()[-1]
    if stored == head:
        return
    copy = _keep_copy(database, head) if stored is not None else None
    try:
        _run_alembic(database)
    except Exception as error:
        reason = getattr(error, "orig", error)  # SQLAlchemy's own text has the statement and a link
        if isinstance(reason, sqlite3.Error):
            reason = store_error(reason, database)
        kept = f"; a copy is in {copy}" if copy else ""
        raise StoreError(
            f"{database}: could not be brought to revision {head} ({reason}); it is as it was{kept}"
        ) from error


def _keep_copy(database: Path, head: str) -> Path:
    copy = database.with_name(f"{database.name}.before-{head}.bak")
    number = 1
    while os.path.lexists(copy):  # a copy is never overwritten: it may be the only one of another state
        number += 1
        copy = database.with_name(f"{database.name}.before-{head}.{number}.bak")
    try:
        copy_database(database, copy)
    except StoreError as error:
        raise StoreError(f"no copy could be kept, so nothing was changed: {error}") from error
    return copy


def _run_alembic(database: Path) -> None:
    from sqlalchemy import NullPool, create_engine, event, text

    # Foreign keys stay off: SQLite changes a table by copying it, and they are checked before the commit.
    engine = create_engine("sqlite://", creator=lambda: connect(database), poolclass=NullPool)

    @event.listens_for(engine, "connect")
    def _begin_by_hand(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = None
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")  # has an effect only before the first table

    @event.listens_for(engine, "begin")
    def _take_the_file(connection: object) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE")  # type: ignore[attr-defined]

    with engine.begin() as connection:
        migrate(connection)
        orphans = connection.execute(text("PRAGMA foreign_key_check")).all()
        if orphans:
            raise ValueError(f"{len(orphans)} rows would lose what they refer to")
