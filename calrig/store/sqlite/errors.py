"""Messages for errors that SQLite or the system reports about a store's file, with what to do."""

import errno
import shutil
from pathlib import Path

from calrig.store.errors import StoreDamagedError, StoreError, StoreUnavailableError

_FULL = "the disk is full: free some space (`keep_samples_days` prunes raw samples)"
_LOCKED = "another program keeps it locked: close that program and try again"
_DAMAGED = (
    "it is damaged: keep a copy of it, then go back to the newest backup (`calrig backup`) or to the newest "
    ".bak copy beside it"
)

_REMEDIES: dict[str, tuple[type[StoreError], str]] = {
    "SQLITE_FULL": (StoreUnavailableError, _FULL),
    "SQLITE_READONLY": (
        StoreUnavailableError,
        "the file or its folder is read-only: make both writable or name another with --db",
    ),
    "SQLITE_CANTOPEN": (
        StoreError,
        "it cannot be opened: check that its folder exists and may be read and written",
    ),
    "SQLITE_PERM": (StoreError, "permission was refused: check who owns the file and its folder"),
    "SQLITE_BUSY": (StoreUnavailableError, _LOCKED),
    "SQLITE_LOCKED": (StoreUnavailableError, _LOCKED),
    "SQLITE_NOTADB": (StoreError, "it is not a SQLite database: name another file with --db"),
    "SQLITE_CORRUPT": (StoreDamagedError, _DAMAGED),
    "SQLITE_IOERR": (
        StoreUnavailableError,
        "the disk could not be read or written: check that it has room (a quota counts) and how it is "
        "mounted, and keep the store on a local disk",
    ),
}
"""What to do for each primary result code (https://www.sqlite.org/rescode.html)."""

_SIGNS_OF_DAMAGE = ("decode to UTF-8", "no such table", "no such column")
"""What is said without a code of its own where text, or a table's definition, is not what was written."""
LITTLE_BYTES = 64 * 1024
"""With less room SQLite cannot make the files beside the store, and speaks of an input/output error."""


def store_error(error: BaseException | None, path: Path) -> StoreError:
    """What SQLite or the system reported about the file at `path`, in words and with what to do."""
    name = getattr(error, "sqlite_errorname", None) or ""
    no_room = isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
    if no_room or (name.startswith("SQLITE_IOERR") and _room_bytes(path) < LITTLE_BYTES):
        name = "SQLITE_FULL"
    if any(sign in str(error) for sign in _SIGNS_OF_DAMAGE):
        name = "SQLITE_CORRUPT"
    for code, (kind, remedy) in _REMEDIES.items():
        if name.startswith(code):
            return kind(f"{path}: {remedy} ({error})")
    who = "SQLite" if name else "the system"
    return StoreError(f"{path}: {who} refused the work ({error})")


def damaged(path: Path, what: str) -> StoreDamagedError:
    """The error for a file that holds something else than was written."""
    return StoreDamagedError(f"{path}: {_DAMAGED} ({what})")


def _room_bytes(path: Path) -> int:
    try:
        return shutil.disk_usage(path.parent).free
    except OSError:
        return LITTLE_BYTES  # nothing is known: SQLite's own words will do
