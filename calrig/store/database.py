"""Interface of a database on either engine: sessions, schema migrations, base of the repositories.

A schema revision is the four digits at the start of its file's name in migrations/versions. So the newest one
is found without importing Alembic, which is loaded only for a migration.
"""

import re
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar

from sqlalchemy import Connection
from sqlalchemy.exc import StatementError
from sqlmodel import Session

from calrig.settings import packed
from calrig.store.errors import NotFound, NotText, StoreDamagedError, StoreError, Unreadable
from calrig.store.records import Size

T = TypeVar("T")
BUSY_TIMEOUT_S = 10.0
LOOK_S = 0.1
"""How soon a write that waits for its turn notices that it is not wanted any more."""


class Database(ABC):
    """An open database. Threads share it: writes take turns, reads never wait for them.

    Attributes:
        name: what messages call it: a path, or a URL without its password.
    """

    name: str

    def __init__(self) -> None:
        self._own = threading.local()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Make one transaction of all that this thread reads and writes until the block ends.

        Where the block raises, nothing is stored. Other writers wait until it ends. One within another is
        part of it.
        """
        outer = self._own_session()
        with self.writing() as session:
            self._own.session = session
            try:
                yield
            finally:
                self._own.session = outer

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """A session that sees one state of the database throughout; that of an open `transaction`, if any."""
        own = self._own_session()
        if own is not None:
            yield own
            return
        with self._reading() as session:
            yield session

    def _own_session(self) -> Session | None:
        return getattr(self._own, "session", None)

    @abstractmethod
    def _reading(self) -> AbstractContextManager[Session]:
        """A session of its own for reading."""

    @abstractmethod
    def staging(self) -> AbstractContextManager[Connection]:
        """A connection with temporary tables of its own, which are gone when the block ends.

        What is laid there keeps nobody from writing; `writing(on=it)` then takes it over in little time.
        """

    @contextmanager
    def writing(self, on: Connection | None = None, *, in_turn: bool = True) -> Iterator[Session]:
        """A session whose changes are kept when the block ends, or none of them where it raises.

        In a `transaction` its changes are kept when that ends.

        `on` is what `staging` gave, else any connection is taken; `in_turn` is False for what counts nothing
        on and so waits for no other writer, where the engine can.

        Raises:
            StoreError: it cannot be written; of waiting for a turn, what `require_wanted` raises as well.
            RuntimeError: it is on a staged connection, and this thread has a `transaction` open.
        """
        own = self._own_session()
        if own is None:
            with self._writing(on, in_turn=in_turn) as session:
                yield session
            return
        if on is not None:
            raise RuntimeError("staged rows are taken over in a transaction of their own")
        yield own
        own.flush()  # statements of the connection see no changes that are pending in the session

    @abstractmethod
    def _writing(self, on: Connection | None, *, in_turn: bool) -> AbstractContextManager[Session]:
        """A session of its own for writing; as `writing`."""

    @abstractmethod
    def give_back_space(self) -> None:
        """Gives back what deletions left empty."""

    @abstractmethod
    def size(self) -> Size:
        """What the store takes, and what is left where it lies."""

    def answers_at(self, address: str) -> None:  # noqa: B027 (only a file has one writer)
        """Says to whoever finds the store taken at which address its holder answers."""

    @abstractmethod
    def close(self) -> None:
        """Closes every connection."""

    @abstractmethod
    def _error(self, error: BaseException | None) -> StoreError:
        """What the engine reported, in words and with what to do."""

    @abstractmethod
    def _damaged(self, what: str) -> StoreDamagedError:
        """The error for something else in the database than was written."""

    @contextmanager
    def _in_words(self) -> Iterator[None]:
        try:
            yield
        except Unreadable as error:
            raise self._damaged(str(error)) from error
        except UnicodeDecodeError as error:
            raise self._damaged(str(error)) from error
        except UnicodeEncodeError as error:
            raise self._no_text(error) from error
        except StatementError as error:
            if isinstance(error.orig, UnicodeEncodeError):
                raise self._no_text(error.orig) from error
            if isinstance(error.orig, ValueError):
                raise ValueError(f"cannot be stored: {error.orig}") from error
            raise self._error(error.orig) from error

    def _no_text(self, error: UnicodeEncodeError) -> NotText:
        """The error for a name of another encoding, as a terminal or a folder may have it."""
        return NotText(f"{self.name}: keeps UTF-8 text, and {error.object[:60]!a} is none: write it in UTF-8")


def row_of(session: Session, table: type[T], key: object, missing: str) -> T:
    """The row of a key; NotFound, which says what is missing, without one."""
    row = session.get(table, key)
    if row is None:
        raise NotFound(missing)
    return row


class Repository:
    """Base of the repositories of a `calrig.store.Store`: each method is one transaction.

    In a `Database.transaction` all methods called are one.
    """

    def __init__(self, database: Database) -> None:
        self._database = database


def revisions() -> list[str]:
    """The program's revisions, oldest first."""
    found = (
        re.match(r"(\d{4})_\w+\.py$", file.name) for file in (packed("migrations") / "versions").iterdir()
    )
    known = sorted(match[1] for match in found if match)
    if not known:
        raise StoreError(f"{packed('migrations')}: holds no migrations: install calrig again")
    return known


def migrate(connection: Connection) -> None:
    """Brings the tables to the program's revision, inside the transaction that the connection is in."""
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(packed("migrations")).replace("%", "%%"))
    config.attributes["connection"] = connection
    command.upgrade(config, "head")
