"""SQLite file: find it, open it, and run short transactions from many threads."""

import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, cast
from urllib.parse import unquote

from sqlalchemy import Connection, QueuePool, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError
from sqlmodel import Session

from calrig.instruments.cancellation import raise_if_cancelled
from calrig.model.run import UNFINISHED
from calrig.store.checksums import from_json, to_json
from calrig.store.database import LOOK_S, Database, revisions
from calrig.store.errors import (
    AddressOfNoStoreError,
    NoStore,
    StoreDamagedError,
    StoreError,
    StoreUnavailableError,
)
from calrig.store.records import Size
from calrig.store.sqlite import copying
from calrig.store.sqlite import file as file_system
from calrig.store.sqlite.errors import damaged, store_error
from calrig.store.sqlite.file import connect, is_a_table
from calrig.store.sqlite.lock import WriterLock


def database_path(url: str) -> Path:
    """The file that an SQLAlchemy URL names; `%3F` in it stands for `?`, and so on.

    Raises:
        StoreError: it is not the URL of a SQLite file, or one that cannot be looked at.
    """
    try:
        parsed = make_url(url)
    except ArgumentError as error:
        raise AddressOfNoStoreError(f"{url!r} is neither a path nor an SQLAlchemy URL") from error
    if parsed.get_backend_name() != "sqlite" or parsed.host or "?" in url:
        shown = parsed.render_as_string(hide_password=True)
        raise AddressOfNoStoreError(
            f"{shown}: a store is a SQLite file (its path, or sqlite:///path) or postgresql+psycopg://…"
        )
    _, _, quoted = url.partition(":///")  # SQLAlchemy unquotes it from 2.1 on only
    named = unquote(quoted, errors="surrogateescape")
    if not named or named == ":memory:":
        raise AddressOfNoStoreError(f"{url}: a store in memory would be lost: name a file")
    path = Path(named).resolve()
    try:
        path.exists()
    except OSError as error:
        raise StoreError(
            f"{path}: cannot be looked at ({error.strerror}): name another file with --db"
        ) from error
    return path


class SqliteDatabase(Database):
    """An open SQLite file. Writes take turns, reads never wait for them (WAL).

    `writer` is what the writer does (`serve`, `run`, `import`), None for reading only; `busy_timeout_s` how
    long to wait for a lock that another process holds; `left_by_the_dead` as of `calrig.store.Store.open`.

    Raises:
        StoreError: as `calrig.store.Store.open`.
    """

    def __init__(
        self,
        path: Path,
        writer: str | None,
        busy_timeout_s: float,
        left_by_the_dead: Callable[[Sequence[str]], None] = lambda _: None,
    ) -> None:
        super().__init__()
        self.path = path
        self.name = str(path)
        self._timeout_s = busy_timeout_s
        self._writes = threading.Lock()
        if path.is_dir():
            raise StoreError(f"{path}: is a folder: name a file in it with --db")
        if path.exists() and not path.is_file():
            raise StoreError(
                f"{path}: is not a file but a {file_system.kind_of(path.stat())}: name one with --db"
            )
        self._engine = create_engine(
            "sqlite://",
            creator=self._connect,
            json_serializer=to_json,
            json_deserializer=from_json,
            poolclass=QueuePool,
            pool_size=8,
            max_overflow=-1,  # a thread never waits for a connection, only for the write lock
        )
        event.listen(self._engine, "begin", self._begin)
        self._write_engine = self._engine.execution_options(calrig_writes=True)
        self._uri = f"{path.as_uri()}?mode=rw"
        self._opened: tuple[int, int] | None = None
        if writer:
            file_system.refuse_network(path)
        self._lock = WriterLock(path, writer) if writer else None
        try:
            if self._lock:
                left_by_the_dead(self._rigs_in_use())
                self._prepare_for_writing()
            else:
                self._check_for_reading()
        except BaseException:
            self.close()
            raise

    def _rigs_in_use(self) -> list[str]:
        """Rigs of unfinished runs; none where the file cannot be read, which the checks to come will say."""
        if not self.path.is_file() or self.path.stat().st_size == 0:  # opened, it would lose its -wal file
            return []
        marks = ", ".join("?" * len(UNFINISHED))
        wanted = f"SELECT DISTINCT rig FROM run WHERE rig IS NOT NULL AND status IN ({marks})"  # noqa: S608
        try:
            with closing(connect(f"{self.path.as_uri()}?mode=ro", self._timeout_s)) as file:
                if not is_a_table(file, "run"):
                    return []
                return [name for (name,) in file.execute(wanted, UNFINISHED)]
        except (sqlite3.Error, UnicodeDecodeError):
            return []

    def _prepare_for_writing(self) -> None:
        uri = None
        if file_system.has_writer(self.path):
            # It died, perhaps with the power: a good moment for damage, which is looked for first.
            uri = file_system.reading_uri(self.path, self._timeout_s)
            with closing(connect(uri, self._timeout_s)) as connection:
                copying.check_sound(connection, self.path)
        if not self.path.exists():
            copying.make_new(self.path)
        elif file_system.size_bytes(self.path) == 0:
            raise StoreError(
                f"{self.path}: is empty (0 bytes), which a store never is; nothing was changed: if it held "
                "a store, go back to a backup (`calrig backup`); delete it to begin a new store"
            )
        stored = copying.stored_revision(self.path, uri)
        copying.check_not_newer(self.path, stored)
        self._opened = file_system.identity(self.path)
        with self._in_words():
            if stored is not None:
                self._engine.connect().close()  # where that cannot be done, nothing is migrated
            copying.upgrade(self.path, stored)
            self._engine.connect().close()

    def _check_for_reading(self) -> None:
        stored = None
        if self.path.is_file():
            self._uri = file_system.reading_uri(self.path, self._timeout_s)
            stored = copying.stored_revision(self.path, self._uri)
            self._opened = file_system.identity(self.path)
        if stored is None:
            raise NoStore(
                f"{self.path}: there is no calrig database: name one with --db, "
                "or make one with `calrig serve`, `calrig run` or `calrig import`"
            )
        copying.check_not_newer(self.path, stored)
        if stored != revisions()[-1]:
            raise StoreError(
                f"{self.path}: was written by an older calrig (revision {stored}): run `calrig serve` once, "
                "which keeps a copy and brings it up to date"
            )

    def _require_same_file(self) -> None:
        """Raise unless the file that was opened still lies at its path.

        An open file goes on without its name: what is written there is lost as soon as it is closed.
        """
        if file_system.identity(self.path) != self._opened:
            raise StoreUnavailableError(
                f"{self.path}: was deleted or replaced by another file while calrig had it open; nothing is "
                "written: put the file back, or restart calrig on the one that is there now"
            )

    def _connect(self) -> sqlite3.Connection:
        self._require_same_file()
        connection = connect(self._uri, self._timeout_s, isolation_level=None, check_same_thread=False)
        connection.create_function("lower", 1, _lower, deterministic=True)
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute("PRAGMA synchronous = FULL")
        if self._lock:
            (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
            if mode != "wal":
                connection.close()
                raise file_system.on_a_network_drive(self.path, f"its journal stays {mode!r}")
        else:
            connection.execute("PRAGMA query_only = ON")
        return connection

    @contextmanager
    def _reading(self) -> Iterator[Session]:
        """As `Database.reading`; a file read as it lies must not have got a writer meanwhile."""
        with self._in_words(), Session(self._engine) as session:
            yield session
        if self._uri.endswith(file_system.AS_IT_LIES) and file_system.has_writer(self.path):
            raise StoreUnavailableError(f"{self.path}: a writer has taken it while it was read: try again")

    @contextmanager
    def staging(self) -> Iterator[Connection]:
        """As `Database.staging`."""
        with self._in_words(), self._engine.connect() as connection:
            connection.detach()  # it is closed in earnest
            yield connection

    @contextmanager
    def _writing(self, on: Connection | None, *, in_turn: bool) -> Iterator[Session]:  # noqa: ARG002
        """As `Database.writing`: what was written is on the disk when the block ends."""
        if self._lock is None:
            raise StoreError(f"{self.path}: was opened for reading only")
        where = self._write_engine if on is None else on.execution_options(calrig_writes=True)
        with self._in_words(), self._turn(), Session(where) as session, session.begin():
            yield session

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """One write at a time; who waits for another one's end gives up once nobody wants his own."""
        while not self._writes.acquire(timeout=LOOK_S):
            raise_if_cancelled()
        try:
            self._require_same_file()
            yield
        finally:
            self._writes.release()

    def _begin(self, connection: Connection) -> None:
        # A transaction that will write says so at once: turning a read into a write can fail midway.
        if connection.get_execution_options().get("calrig_writes"):
            self._lock_for_writing(cast(sqlite3.Connection, connection.connection.dbapi_connection))
        else:
            connection.exec_driver_sql("BEGIN")

    def _lock_for_writing(self, raw: sqlite3.Connection) -> None:
        """Waits for another program's lock in short stretches, as long as somebody wants the write."""
        give_up_s = time.monotonic() + self._timeout_s
        raw.execute(f"PRAGMA busy_timeout = {1000 * min(LOOK_S, self._timeout_s):.0f}")
        try:
            while True:
                try:
                    raw.execute("BEGIN IMMEDIATE")
                    return
                except sqlite3.OperationalError as error:
                    is_busy = error.sqlite_errorname.startswith("SQLITE_BUSY")
                    if not is_busy or time.monotonic() >= give_up_s:
                        raise
                raise_if_cancelled()
        finally:
            raw.execute(f"PRAGMA busy_timeout = {1000 * self._timeout_s:.0f}")

    def give_back_space(self) -> None:
        """Shortens the file by the pages that deletions left empty."""
        with self._in_words(), self._turn(), self._engine.connect() as connection:
            raw = cast(sqlite3.Connection, connection.connection.driver_connection)
            raw.executescript("PRAGMA incremental_vacuum")  # `execute` steps once: one page

    def _error(self, error: BaseException | None) -> StoreError:
        return store_error(error, self.path)

    def _damaged(self, what: str) -> StoreDamagedError:
        return damaged(self.path, what)

    @contextmanager
    def _in_words(self) -> Iterator[None]:
        with super()._in_words():
            try:
                yield
            except sqlite3.Error as error:
                raise store_error(error, self.path) from error

    def size(self) -> Size:
        """What the store takes of its disk."""
        files = (self.path, self.path.with_name(f"{self.path.name}-wal"))
        used_bytes = sum(file_system.size_bytes(file) for file in files)
        return Size(used_bytes, shutil.disk_usage(self.path.parent).free)

    def answers_at(self, address: str) -> None:
        """Says in the writer's lock at which address its holder answers."""
        if self._lock:
            self._lock.answers_at(address)

    def close(self) -> None:
        """Closes every connection and lets the writer's lock go."""
        self._engine.dispose()
        if self._lock:
            self._lock.close()
            self._lock = None


def _lower(value: Any) -> Any:
    """SQLite's own knows the letters of ASCII alone."""
    return value.lower() if isinstance(value, str) else value
