"""What can go wrong with the store, each said so that a person can act on it."""

from __future__ import annotations

from pathlib import Path


class StoreError(Exception):
    """The store cannot be used. The message names the file, what happened and what to do."""


class NotFound(StoreError):  # noqa: N818 (an answer, not a fault)
    """There is no such run, or the run has no such pose."""


_REMEDIES = {
    "SQLITE_FULL": "the disk is full: free some space (`keep_samples_days` prunes raw samples)",
    "SQLITE_READONLY": "the file or its folder is read-only: make both writable or name another with --db",
    "SQLITE_CANTOPEN": "it cannot be opened: check that its folder exists and may be read and written",
    "SQLITE_PERM": "permission was refused: check who owns the file and its folder",
    "SQLITE_BUSY": "another program keeps it locked: close that program and try again",
    "SQLITE_LOCKED": "another program keeps it locked: close that program and try again",
    "SQLITE_NOTADB": "it is not a SQLite database: name another file with --db",
    "SQLITE_CORRUPT": "it is damaged: keep a copy of it and go back to the newest .bak copy beside it",
    "SQLITE_IOERR": "the disk could not be read or written: check the disk and how it is mounted",
}
"""What to do for each primary result code (https://www.sqlite.org/rescode.html)."""


def in_words(error: BaseException | None, path: Path) -> str:
    """What SQLite reported about the file at `path`, as one sentence with what to do."""
    name = getattr(error, "sqlite_errorname", "") or ""
    for code, remedy in _REMEDIES.items():
        if name.startswith(code):
            return f"{path}: {remedy} ({error})"
    return f"{path}: SQLite refused the work ({error})"
