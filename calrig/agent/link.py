"""Connection of a bench to its centre's database: short statements, reconnection after each loss, lease.

The role of a bench may touch only the rows of its bench. Every statement is a transaction of its own.

The lease says how long a bench may act on orders after the centre's last answer, by the bench's clock. It
keeps a disconnected bench from starting outdated orders; the epochs of orders keep runs from starting twice.
"""

import random
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import psycopg
from psycopg.types.json import Json

from calrig.store.checksums import sealed, to_json
from calrig.store.postgresql.connection import Connection, connect

FIRST_PAUSE_S = 0.25
LONGEST_PAUSE_S = 8.0
CLOSE_S = 1.0
PATIENCE_MS = 5000
"""How long the server may take over one statement, wait for a lock, or for the rest of a transaction."""
SILENT_S = 7.0
"""After that the connection is dropped: the server itself has ended the statement sooner."""
NOW = """to_char(clock_timestamp() AT TIME ZONE 'UTC', 'YYYY-MM-DD"T"HH24:MI:SS.US"+00:00"')"""
"""The server's time as the store writes times."""
_WHOSE = "SELECT name FROM bench WHERE role = session_user AND revoked_at IS NULL"


class LinkDown(Exception):  # noqa: N818 (a state, and no defect)
    """The centre cannot be spoken to now; says why."""


@dataclass(frozen=True, slots=True)
class Centre:
    """The centre's database, while a connection is open, and the bench that speaks to it."""

    connection: Connection
    bench: str


def json_of(document: Mapping[str, Any]) -> Json:
    """A document as the store's columns have it."""
    return Json(sealed(document), dumps=to_json)


class Link:
    """One connection, for one statement after the other. Thread-safe.

    Args:
        url: of the database, as libpq takes it.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._lock = threading.Lock()
        self._centre: Centre | None = None
        self._pause_s = FIRST_PAUSE_S
        self._not_before_s = 0.0
        self._why = ""

    @contextmanager
    def centre(self) -> Iterator[Centre]:
        """The centre; connects where that has not been done, and not too often where it fails.

        Raises:
            LinkDown: there is no connection, or it was lost meanwhile; a statement may have been carried out
                all the same.
        """
        with self._lock:
            centre = self._centre or self._connect()
            try:
                yield centre
            except psycopg.Error as error:
                self._close()
                raise LinkDown(_said(error)) from error

    def close(self) -> None:
        """Closes the connection, unless somebody still waits for what it says."""
        if self._lock.acquire(timeout=CLOSE_S):
            self._close()
            self._lock.release()

    def _connect(self) -> Centre:
        if time.monotonic() < self._not_before_s:
            raise LinkDown(self._why)
        try:
            self._centre = _connected(self._url)
        except (psycopg.Error, LinkDown) as error:
            self._why = _said(error)
            self._not_before_s = time.monotonic() + self._pause_s * random.uniform(0.5, 1.0)  # noqa: S311
            self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            raise LinkDown(self._why) from error
        self._pause_s = FIRST_PAUSE_S
        return self._centre

    def _close(self) -> None:
        if self._centre is not None:
            with suppress(psycopg.Error):
                self._centre.connection.close()
        self._centre = None


def _connected(url: str) -> Centre:
    connection = connect(url, SILENT_S)
    try:
        for limit in ("statement_timeout", "lock_timeout", "idle_in_transaction_session_timeout"):
            connection.execute(f"SET {limit} = {PATIENCE_MS}")
        found = connection.execute(_WHOSE).fetchone()
        if found is None:
            raise LinkDown("this role is no bench's, or was revoked: join again with `calrig agent enroll`")
        return Centre(connection, found[0])
    except BaseException:
        connection.close()
        raise


_OWNS = "SELECT pg_has_role(session_user, relowner, 'MEMBER') FROM pg_class WHERE oid = to_regclass('bench')"
ASKS_S = 2


def is_of_owner(url: str) -> bool:
    """Return whether a URL logs in as the owner of the centre's database, or as one who may all it may.

    No role of a bench may. False if the centre cannot be asked within `ASKS_S`.

    Args:
        url: of the database, as libpq takes it.
    """
    try:
        with connect(url, ASKS_S, connect_timeout=ASKS_S) as connection:
            found = connection.execute(_OWNS).fetchone()
    except psycopg.Error:
        return False
    return found is not None and bool(found[0])


def _said(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


LEASE_S = 15.0


class Lease:
    """Held for `LEASE_S` from before the question that the centre answered last. Thread-safe.

    Args:
        now_s: seconds that never go back.

    Attributes:
        losses: how often it was found lost.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self.now_s = now_s
        self._lock = threading.RLock()
        self._until_s: float | None = None
        self.losses = 0

    def renew(self, asked_at_s: float, *, is_anew: bool) -> bool:
        """The centre answered what was asked then; returns whether the lease was not held before.

        It is taken anew only where `is_anew`, of who has held back what was ordered before.
        """
        with self._lock:
            was_held = self.is_held()
            if was_held or is_anew:
                self._until_s = asked_at_s + LEASE_S
        return not was_held

    def is_held(self) -> bool:
        """Whether orders may be acted on."""
        with self._lock:
            if self._until_s is None:
                return False
            if self.now_s() < self._until_s:
                return True
            self._until_s = None
            self.losses += 1
            return False
