"""One writer at a time: an advisory lock beside the database that says who holds it."""

from __future__ import annotations

import fcntl
import json
import os
import socket
from datetime import UTC, datetime
from pathlib import Path

from calrig.store.errors import StoreError, store_error
from calrig.store.file_system import on_a_network_drive


class WriterLock:
    """Holds `<database>.lock` until closed. The kernel lets it go when the process dies, however it dies.

    Not `filelock`: it empties the file before it tries the lock, so that whoever finds the store taken would
    wipe out who holds it. What it does beside that is the one call of `flock`.

    Args:
        database: the database's file.
        what: what the writer does, for whoever finds the lock taken: `serve`, `run`, `import`.

    Raises:
        StoreError: another writer holds it (who, since when), or the file cannot be made.
    """

    def __init__(self, database: Path, what: str) -> None:
        self.path = database.with_name(f"{database.name}.lock")
        try:
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise StoreError(
                f"{self.path}: the writer's lock cannot be made ({error.strerror}): check that the folder "
                "exists and may be written, or name another database with --db"
            ) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = self._holder()
            os.close(self._file)
            if not isinstance(error, BlockingIOError):
                raise on_a_network_drive(database, f"it cannot be locked: {error.strerror}") from error
            raise StoreError(
                f"{database}: {holder} writes to it, and a store has one writer at a time: "
                "stop that one first, or name another database with --db"
            ) from error
        mine = {
            "pid": os.getpid(),
            "what": what,
            "host": socket.gethostname(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        try:
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, json.dumps(mine).encode(), 0)
        except OSError as error:
            os.close(self._file)
            raise store_error(error, self.path) from error

    def _holder(self) -> str:
        try:
            holder = json.loads(os.pread(self._file, 4096, 0))
            return "`calrig {what}` (process {pid} on {host}, since {since})".format(**holder)
        except (ValueError, KeyError, TypeError):
            return "another program"  # it has the lock and has not yet written its name

    def close(self) -> None:
        """Lets the lock go. The file stays: removing it could take it from the next holder."""
        try:
            os.ftruncate(self._file, 0)
        finally:
            os.close(self._file)
