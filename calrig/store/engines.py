"""Open a store with its engine: a SQLite file, or PostgreSQL if many benches share one store."""

from collections.abc import Callable, Sequence

from sqlalchemy import make_url
from sqlalchemy.exc import ArgumentError

from calrig.store.database import Database
from calrig.store.errors import StoreError
from calrig.store.sqlite.database import SqliteDatabase, database_path

EXTRA = "pip install 'calrig[centre]'"


def is_centre(url: str) -> bool:
    """Whether a store's URL names a PostgreSQL database."""
    try:
        return make_url(url).get_backend_name() == "postgresql"
    except ArgumentError:
        return False  # which the path of a file will say


def shown(url: str) -> str:
    """A store's URL as people may see it."""
    return make_url(url).render_as_string(hide_password=True) if is_centre(url) else url


def open_database(
    url: str,
    writer: str | None,
    busy_timeout_s: float,
    left_by_the_dead: Callable[[Sequence[str]], None],
) -> Database:
    """Opens what a store's URL names; arguments and errors as of `calrig.store.Store.open`."""
    if not is_centre(url):
        return SqliteDatabase(database_path(url), writer, busy_timeout_s, left_by_the_dead)
    try:
        from calrig.store.postgresql.database import PostgresqlDatabase
    except ModuleNotFoundError as error:
        raise StoreError(f"{shown(url)}: needs {error.name}: {EXTRA}") from error
    return PostgresqlDatabase(url, writer, busy_timeout_s)
