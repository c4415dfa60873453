"""Single writer of a file: an advisory lock beside the database that names its holder."""

import contextlib
import fcntl
import json
import os
import socket
import stat
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from calrig.store.errors import StoreError, Taken
from calrig.store.sqlite import file as file_system
from calrig.store.sqlite.errors import store_error

SOCKETS = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
"""Linux: each socket with its address, state and user (proc_pid_net(5))."""
LISTENS = "0A"
WORD = 8
"""Hexadecimal digits of an address that are one number of the machine's byte order."""


def is_ours(address: str) -> bool:
    """Whether whoever answers at `http://127.0.0.1:8000` is a process of this user.

    A service lets its port go before its lock, and a port that is free is anybody's. True where the system
    does not tell.
    """
    named = urlsplit(address)
    try:
        host, port = ip_address(named.hostname or ""), named.port
    except ValueError:
        return False
    if not SOCKETS[0].exists():
        return True
    users = [user for where, at, user in _listeners() if at == port and _takes(where, host)]
    return bool(users) and set(users) == {os.geteuid()}


def _takes(where: IPv4Address | IPv6Address, host: IPv4Address | IPv6Address) -> bool:
    """Whether a socket that listens there may take what is sent to a host."""
    bound = getattr(where, "ipv4_mapped", None) or where
    is_any = where.is_unspecified and (where.version == 6 or host.version == 4)
    return bound == host or is_any


def _listeners() -> Iterator[tuple[IPv4Address | IPv6Address, int, int]]:
    """Address, port and user of each socket that listens."""
    for table in SOCKETS:
        if not table.exists():  # a machine without IPv6
            continue
        for line in table.read_text().splitlines()[1:]:
            _, local, _, state, _, _, _, user, *_ = line.split()
            if state == LISTENS:
                where, _, port = local.partition(":")
                words = (int(where[k : k + WORD], 16) for k in range(0, len(where), WORD))
                packed = b"".join(word.to_bytes(4, sys.byteorder) for word in words)
                yield ip_address(packed), int(port, 16), int(user)


FLAGS = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY
BEGINNING = b'{"pid"'
"""Of what a writer leaves in its lock; nothing, or zeros after a power cut, may be there instead."""


class WriterLock:
    """Holds `<database>.lock` until closed. The kernel lets it go when the process dies, however it dies.

    Not `filelock`: it empties the file before it tries the lock, so that whoever finds the store taken would
    wipe out who holds it. What it does beside that is the one call of `flock`.

    `what` the writer does is for whoever finds the lock taken: `serve`, `run`, `import`.

    Raises:
        StoreError: another writer holds it (who, since when), the file cannot be made, or something else
            lies in its place, which is left alone.
    """

    def __init__(self, database: Path, what: str) -> None:
        self.path = _path(database)
        self._file = self._opened(database)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            said = _said(self._file)
            os.close(self._file)
            if not isinstance(error, BlockingIOError):
                raise file_system.on_a_network_drive(
                    database, f"it cannot be locked: {error.strerror}"
                ) from error
            raise Taken(
                f"{database}: {_in_words(said)} writes to it, and a store has one writer at a time: "
                "stop that one first, or name another database with --db",
                is_served="at" in said,
            ) from error
        self._mine = {  # `pid` first: what begins with it is known to be a lock
            "pid": os.getpid(),
            "what": what,
            "host": socket.gethostname(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        try:
            self._write()
        except OSError as error:
            os.close(self._file)
            raise store_error(error, self.path) from error

    def answers_at(self, address: str) -> None:
        """Says at which address its holder answers, for commands of its user's that would write too."""
        self._mine["at"] = address
        self._write()

    def _write(self) -> None:
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, json.dumps(self._mine).encode(), 0)

    def _opened(self, database: Path) -> int:
        """The file, opened and made where there was none; what a link or a device leads to is not touched."""
        try:
            with contextlib.suppress(FileNotFoundError):
                self._refuse(self.path.lstat())  # opening a device can be an act already
            file = os.open(self.path, FLAGS, file_system.PRIVATE)
        except OSError as error:
            raise StoreError(
                f"{self.path}: the writer's lock cannot be made ({error.strerror}): check that the folder "
                "exists and may be written, or name another database with --db"
            ) from error
        try:
            found = os.fstat(file)
            self._refuse(found)
            if os.pread(file, len(BEGINNING), 0).strip(b"\0") not in {b"", BEGINNING}:
                raise self._not_a_lock("is a file that holds something else")
            # Who may write the store must be able to lock it; that may be more than its owner.
            mode = stat.S_IMODE(database.stat().st_mode) if database.exists() else file_system.PRIVATE
            if found.st_uid == os.geteuid() and stat.S_IMODE(found.st_mode) != mode:
                os.fchmod(file, mode)
        except OSError as error:
            os.close(file)
            raise store_error(error, self.path) from error
        except StoreError:
            os.close(file)
            raise
        return file

    def _refuse(self, found: os.stat_result) -> None:
        if not stat.S_ISREG(found.st_mode):
            raise self._not_a_lock(f"is a {file_system.kind_of(found)}")

    def _not_a_lock(self, why: str) -> StoreError:
        return StoreError(
            f"{self.path}: {why}, where the store's lock belongs; nothing was changed: remove it or name "
            "another database with --db"
        )

    def close(self) -> None:
        """Lets the lock go. The file stays: removing it could take it from the next holder."""
        try:
            os.ftruncate(self._file, 0)
        finally:
            os.close(self._file)


def living_writer(database: Path) -> str | None:
    """Who writes to a store now, in words; None where nobody does. For who looks, and will not write."""
    with _held(database) as file:
        return None if file is None else _in_words(_said(file))


def answering_at(database: Path) -> str | None:
    """Where the service answers that writes to a store now, if it is this user's; else None.

    A token may be sent there: nobody else could have written the address, which its living process did, and
    nobody else listens at it.
    """
    with _held(database) as file:
        if file is None or not _is_ours_alone(os.fstat(file)):
            return None
        said = _said(file)
        try:
            address, is_here = said["at"], said["host"] == socket.gethostname()
            os.kill(said["pid"], 0)  # refused where it is another user's
        except (KeyError, TypeError, OverflowError, OSError):
            return None
    return address if is_here and isinstance(address, str) and is_ours(address) else None


def _is_ours_alone(found: os.stat_result) -> bool:
    others_write = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid() and not others_write


@contextlib.contextmanager
def _held(database: Path) -> Iterator[int | None]:
    """The lock's file, opened for reading, where a writer holds it."""
    try:
        file = os.open(
            _path(database), os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY
        )
    except OSError:
        yield None  # nobody has ever written here
        return
    try:
        yield file if _is_held(file) else None
    finally:
        os.close(file)


def _is_held(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        pass  # a drive without locks, to which nobody writes
    return False


def _path(database: Path) -> Path:
    return database.with_name(f"{database.name}.lock")


def _said(file: int) -> dict[str, Any]:
    """What the holder has written; nothing, where it has the lock and has not yet written its name."""
    try:
        said = json.loads(os.pread(file, 4096, 0))
    except ValueError:
        return {}
    return said if isinstance(said, dict) else {}


def _in_words(said: dict[str, Any]) -> str:
    try:
        return "`calrig {what}` (process {pid} on {host}, since {since})".format(**said)
    except KeyError:
        return "another program"
