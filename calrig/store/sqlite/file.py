"""Connections to a file that another program may have changed: its schema cannot execute anything.

Also finds which file system the file is on, and how it can be read there.
"""

import contextlib
import os
import sqlite3
import stat
from pathlib import Path
from typing import Any

from calrig.store.errors import StoreError
from calrig.store.sqlite.errors import damaged, store_error

MOST_NAMED = 5
IS_VIRTUAL = "(type = 'table' AND rootpage = 0)"


def connect(where: str | Path, timeout_s: float = 5.0, **options: Any) -> sqlite3.Connection:
    """A connection whose schema may call no function that does more than compute.

    https://www.sqlite.org/security.html, "Untrusted SQLite database files".

    `where` is a path or a URI; another connection's lock is waited for `timeout_s`.
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


NETWORK = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "afs", "ncpfs", "fuse.sshfs", "fuse.davfs", "fuse.rclone"}
)
"""File systems on which memory is not shared between hosts, which SQLite's write-ahead log needs."""
AS_IT_LIES = "?immutable=1"
"""Ends the URI of a file that is read without locks."""
_KINDS = {
    stat.S_IFLNK: "symbolic link",
    stat.S_IFDIR: "folder",
    stat.S_IFIFO: "pipe",
    stat.S_IFSOCK: "socket",
}
MOUNTS = Path("/proc/self/mountinfo")


PRIVATE = 0o600
"""Mode of a new store and of copies. What SQLite makes beside a store has the store's own mode."""


def make_private(path: Path) -> None:
    """Makes an empty file for its owner alone, whatever the umask; OSError where anything is there."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, PRIVATE)
    try:
        os.fchmod(file, PRIVATE)
    finally:
        os.close(file)


def kind_of(found: os.stat_result) -> str:
    """What something that is no file is, in words."""
    return _KINDS.get(stat.S_IFMT(found.st_mode), "device")


def refuse_network(path: Path) -> None:
    """Raises StoreError where a file lies on a network drive: hosts would not see each other's writing."""
    kind = file_system(path)
    if kind in NETWORK:
        raise on_a_network_drive(path, kind)


def on_a_network_drive(path: Path, why: str) -> StoreError:
    """The error for a file that cannot be shared safely where it lies."""
    return StoreError(
        f"{path}: lies on a network drive, or on one that programs cannot share safely ({why}): nothing was "
        "changed: keep the store on a local disk, and copy it to the drive with `calrig backup FILE`"
    )


def file_system(path: Path) -> str | None:
    """The type of the file system that a path lies on, as Linux names it; None elsewhere."""
    try:
        lines = MOUNTS.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return None
    found: tuple[int, str] | None = None
    for line in lines:  # proc(5): id parent device root mount-point options … - type source options
        before, _, after = line.partition(" - ")
        point = before.split(" ")[4].encode().decode("unicode_escape", "surrogateescape")
        if path.is_relative_to(point) and (found is None or len(point) >= found[0]):
            found = len(point), after.split(" ")[0]
    return found[1] if found else None


def reading_uri(path: Path, timeout_s: float) -> str:
    """How to open a file for reading: beside its writer, or as it lies.

    SQLite reads beside a writer through the files -wal and -shm, which it makes where there are none. Where
    it cannot (a read-only folder, a full disk, a network drive) and nobody has the store open, the
    file alone holds everything and is read without a lock.

    Raises:
        StoreError: it cannot be read either way.
    """
    beside = f"{path.as_uri()}?mode=ro"  # or the last one to leave would tidy up: readers change nothing
    as_it_lies = f"{path.as_uri()}{AS_IT_LIES}"
    if has_writer(path) and size_bytes(path) == 0:  # SQLite would throw that file away
        raise damaged(path, "it is empty and its -wal file is not")
    if file_system(path) in NETWORK:
        if has_writer(path):
            refuse_network(path)
        return as_it_lies
    try:
        _look(path, beside, timeout_s)
    except sqlite3.Error as error:
        name = error.sqlite_errorname or ""
        if not name.startswith(("SQLITE_CANTOPEN", "SQLITE_READONLY", "SQLITE_IOERR")) or has_writer(path):
            raise store_error(error, path) from error
        try:
            _look(path, as_it_lies, timeout_s)
        except sqlite3.Error:
            raise store_error(error, path) from error
        return as_it_lies
    return beside


def has_writer(path: Path) -> bool:
    """Whether some of the store is in the -wal file beside it: a writer has it open, or died with it."""
    return size_bytes(path.with_name(f"{path.name}-wal")) > 0


def size_bytes(path: Path) -> int:
    """How large a file is; 0 where there is none."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def identity(path: Path) -> tuple[int, int] | None:
    """Which file lies at a path: its device and number; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _look(path: Path, uri: str, timeout_s: float) -> None:
    with contextlib.closing(connect(uri, timeout_s)) as connection:
        try:
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        except UnicodeDecodeError as error:  # of SQLite's own message, with a table's broken name in it
            raise damaged(path, str(error)) from error
