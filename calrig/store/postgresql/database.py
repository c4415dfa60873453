"""PostgreSQL database: any number of processes write, one transaction at a time."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import psycopg
from sqlalchemy import URL, Connection, create_engine, event, inspect, make_url, text
from sqlalchemy.exc import OperationalError
from sqlmodel import Session

from calrig.instruments.cancellation import raise_if_cancelled
from calrig.store.checksums import from_json, to_json
from calrig.store.database import LOOK_S, Database, migrate, revisions
from calrig.store.errors import StoreDamagedError, StoreError, StoreUnavailableError
from calrig.store.postgresql import connection as client
from calrig.store.postgresql.errors import DAMAGED, store_error
from calrig.store.postgresql.set_up import is_secure, is_set_up, keep_benches_out, secure, set_up
from calrig.store.records import Size

TURN = 0x63616C726967
"""Advisory lock of who writes: numbers that follow on one another (revisions, the trail, a run's events)
are read and written again in one turn, as under SQLite's one writer.
"""
ATTEMPTS = 10
"""At bringing a database up to date in which benches are at work."""
HELD_S = 60
"""How long the server keeps a writer's turn for a client that says nothing."""


def url_of(url: str) -> URL:
    """The URL with psycopg as its driver, whichever it names."""
    return make_url(url).set(drivername="postgresql+psycopg")


class PostgresqlDatabase(Database):
    """An open PostgreSQL database.

    Args:
        url: SQLAlchemy URL.
        writer: None opens for reading only.
        busy_timeout_s: how long to wait for one's turn to write.

    Raises:
        StoreError: as `calrig.store.Store.open`.
    """

    def __init__(self, url: str, writer: str | None, busy_timeout_s: float) -> None:
        super().__init__()
        parsed = url_of(url)
        self.name = parsed.render_as_string(hide_password=True)
        self._timeout_s = busy_timeout_s
        self._may_write = writer is not None
        self._engine = create_engine(
            parsed,
            json_serializer=to_json,
            json_deserializer=from_json,
            pool_size=8,
            max_overflow=-1,
            pool_pre_ping=True,  # the server may have been started again
            connect_args=client.ALIVE,
        )
        event.listen(self._engine, "do_connect", _connect)
        event.listen(self._engine, "checkin", _wait_for_a_ping)
        event.listen(self._engine, "checkout", _wait_for_a_statement)
        self._reads = self._engine.execution_options(
            isolation_level="REPEATABLE READ", postgresql_readonly=True
        )
        try:
            with self._in_words():
                self._prepare()
        except BaseException:
            self.close()
            raise

    def _prepare(self) -> None:
        head = self._head = revisions()[-1]
        with self._engine.connect() as connection:
            stored = self._stored_revision(connection)
            is_ready = not self._may_write or (is_set_up(connection) and is_secure(connection))
            if stored == head and is_ready:
                return
        if stored is not None and stored not in revisions():
            raise StoreError(
                f"{self.name}: was written by a newer calrig (revision {stored}; this one knows up to "
                f"{head}); nothing was changed: install the newer calrig"
            )
        if not self._may_write:
            why, remedy = "there is no calrig database", "make one with `calrig serve` or `calrig move-store`"
            if stored is not None:
                why = f"was written by an older calrig (revision {stored})"
                remedy = "run `calrig serve` once, which brings it up to date"
            raise StoreError(f"{self.name}: {why}: {remedy}")
        self._upgrade(head)

    def _stored_revision(self, connection: Connection) -> str | None:
        tables = inspect(connection).get_table_names()
        if "alembic_version" not in tables:
            return None
        if "calibration" not in tables:
            raise StoreError(f"{self.name}: is another program's database: name another one with --db")
        return connection.execute(text("SELECT version_num FROM alembic_version")).scalar()

    def _upgrade(self, head: str) -> None:
        """Brings the tables up to date, all of it or nothing; of several processes the first does it."""
        for left in reversed(range(ATTEMPTS)):
            try:
                with self._engine.begin() as connection:
                    client.wait_long(connection)
                    self._bring_up(connection, head)
                return
            except OperationalError as error:  # a bench was in the middle of a transaction
                if not left or not isinstance(error.orig, psycopg.errors.DeadlockDetected):
                    raise

    def _bring_up(self, connection: Connection, head: str) -> None:
        connection.execute(text("SELECT pg_advisory_xact_lock(:turn)"), {"turn": TURN})
        if self._stored_revision(connection) == head and is_set_up(connection) and is_secure(connection):
            return
        keep_benches_out(connection)
        if self._stored_revision(connection) != head:
            migrate(connection)
        if not is_set_up(connection):
            set_up(connection)
        secure(connection)

    @contextmanager
    def _reading(self) -> Iterator[Session]:
        with self._in_words(), Session(self._reads) as session:
            yield session

    @contextmanager
    def staging(self) -> Iterator[Connection]:
        """As `Database.staging`."""
        with self._in_words(), self._engine.connect() as connection:
            client.wait_long(connection)
            connection.detach()  # it is closed in earnest
            yield connection

    @contextmanager
    def _writing(self, on: Connection | None, *, in_turn: bool) -> Iterator[Session]:
        """As `Database.writing`."""
        if not self._may_write:
            raise StoreError(f"{self.name}: was opened for reading only")
        with self._in_words(), Session(self._engine if on is None else on) as session:
            if in_turn:
                self._take_turn(session)
            yield session
            session.commit()

    def _take_turn(self, session: Session) -> None:
        """Waits for the other writers in short stretches, as long as somebody wants the write."""
        give_up_s = time.monotonic() + self._timeout_s
        while True:
            raise_if_cancelled()
            session.execute(text(f"SET LOCAL lock_timeout = {1000 * min(LOOK_S, self._timeout_s):.0f}"))
            try:
                session.execute(text("SELECT pg_advisory_xact_lock(:turn)"), {"turn": TURN})
            except OperationalError as error:
                is_busy = isinstance(error.orig, psycopg.errors.LockNotAvailable)
                if not is_busy or time.monotonic() >= give_up_s:
                    raise
                session.rollback()
                continue
            session.execute(text(f"SET LOCAL lock_timeout = {1000 * self._timeout_s:.0f}"))
            session.execute(text(f"SET LOCAL idle_in_transaction_session_timeout = '{HELD_S} s'"))
            self._require_own_tables(session)
            return

    def _require_own_tables(self, session: Session) -> None:
        """Refuse to write into tables that a newer calrig has changed since this one opened them."""
        stored = session.execute(text("SELECT version_num FROM alembic_version")).scalar()
        if stored != self._head:
            raise StoreUnavailableError(
                f"{self.name}: another calrig changed the tables meanwhile (revision {stored}; this one "
                f"writes {self._head}); nothing was changed: install the same version here and start it again"
            )

    def give_back_space(self) -> None:
        """Nothing: the server's own autovacuum does."""

    def size(self) -> Size:
        """What the database takes on the server."""
        with self._in_words(), self._engine.connect() as connection:
            used_bytes = connection.execute(text("SELECT pg_database_size(current_database())")).scalar_one()
        return Size(used_bytes, None)

    def close(self) -> None:
        """Closes every connection."""
        self._engine.dispose()

    def _error(self, error: BaseException | None) -> StoreError:
        return store_error(error, self.name)

    def _damaged(self, what: str) -> StoreDamagedError:
        return StoreDamagedError(f"{self.name}: {DAMAGED} ({what})")


def _connect(_dialect: object, _record: object, arguments: Any, options: Any) -> client.Connection:
    return client.Connection.connect(*arguments, **options)


def _wait_for_a_ping(connection: client.Connection | None, _record: object) -> None:
    """In the pool a connection waits for its ping, which has the server do nothing."""
    if connection is not None:
        connection.silent_s = client.PING_S


def _wait_for_a_statement(connection: client.Connection, _record: object, _fairy: object) -> None:
    connection.silent_s = client.SILENT_S
