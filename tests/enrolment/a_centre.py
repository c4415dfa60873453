"""A centre's database on a real server, and benches that have joined it: roles that are no superusers."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import psycopg
import pytest
from sqlalchemy import make_url

from calrig.store import Store


def connect(url: str) -> psycopg.Connection:
    """A connection as whom the URL names."""
    named = make_url(url).set(drivername="postgresql")
    return psycopg.connect(named.render_as_string(hide_password=False), autocommit=True)


def prepare(url: str) -> None:
    """What a centre does before anything else: what is missing of its database is laid."""
    Store.open(url, writer="tests").close()


def forget_roles(admin: str) -> None:
    """Drops the roles of a database's benches: the server would keep them."""
    with connect(admin) as connection, turn(connection):
        made = connection.execute("SELECT role FROM bench WHERE role IS NOT NULL").fetchall()
        for (role,) in made:
            connection.execute(f'DROP OWNED BY "{role}"')
            connection.execute(f'DROP ROLE "{role}"')


@contextmanager
def turn(server: psycopg.Connection) -> Iterator[None]:
    """Workers of a test run take turns with what the server has once."""
    server.execute("SELECT pg_advisory_lock(1)")
    yield
    server.execute("SELECT pg_advisory_unlock(1)")


def of(url: str, **parts: str) -> str:
    """A server's URL with other parts."""
    named = make_url(url).set(drivername="postgresql+psycopg", **parts)
    return named.render_as_string(hide_password=False)


@dataclass(frozen=True)
class Centre:
    """A centre's store and its URL."""

    store: Store
    url: str

    def join(self, name: str) -> str:
        """URL by which a new bench reaches the database."""
        _, code = self.store.enrolment.add(name)
        return self.store.enrolment.enroll(code)[1]


@pytest.fixture(scope="session")
def owned_template(postgresql_server: str) -> Iterator[tuple[str, str]]:
    """A centre's empty database and the role that owns it, which is no superuser and may make roles."""
    name = f"calrig_owned_{uuid.uuid4().hex[:12]}"
    owner = f"{name}_owner"
    with connect(postgresql_server) as server:
        with turn(server):
            server.execute(f"CREATE ROLE {owner} LOGIN CREATEROLE")
            # Another worker's centre, whose turn this is not, may be making it just now.
            there_is_one = "EXCEPTION WHEN duplicate_object OR unique_violation THEN NULL"
            server.execute(f"DO 'BEGIN CREATE ROLE calrig_bench; {there_is_one}; END'")
            server.execute(f"GRANT calrig_bench TO {owner} WITH ADMIN OPTION")
            server.execute(f"CREATE DATABASE {name} OWNER {owner}")
        url = of(postgresql_server, database=name, username=owner)
        prepare(url)
        yield name, owner
        with turn(server):
            server.execute(f"DROP DATABASE {name} WITH (FORCE)")
            server.execute(f"DROP ROLE {owner}")


@pytest.fixture(scope="module")
def centre(postgresql_server: str, owned_template: tuple[str, str]) -> Iterator[Centre]:
    """A centre whose owner is no superuser."""
    template, owner = owned_template
    name = f"calrig_{uuid.uuid4().hex[:12]}"
    with connect(postgresql_server) as server:
        with turn(server):
            server.execute(f"CREATE DATABASE {name} TEMPLATE {template} OWNER {owner}")
        url = of(postgresql_server, database=name, username=owner)
        with Store.open(url, writer="tests") as store:
            yield Centre(store, url)
        forget_roles(of(postgresql_server, database=name))
        with turn(server):
            server.execute(f"DROP DATABASE {name} WITH (FORCE)")
