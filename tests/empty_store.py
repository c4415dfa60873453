"""An empty store's file, made once by the migrations and copied ever after."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest


@cache
def _empty_store() -> bytes:
    from calrig.store import Store

    with TemporaryDirectory() as folder:
        Store.open(f"sqlite:///{folder}/calrig.db", writer="tests").close()
        return Path(folder, "calrig.db").read_bytes()


def lay_empty_store(path: Path) -> None:
    """Lays an empty store where there is none: a copy of one that its migrations have made once."""
    if not path.exists():
        path.write_bytes(_empty_store())


class Hurried(sqlite3.Connection):
    """A connection that leaves it to the system when its file is on the disk: no power is cut here.

    To wait for that took up to a third of a run in virtual time.
    """

    def execute(self, statement: str, *given: Any) -> sqlite3.Cursor:
        """As its own, but for what calrig asks of each connection."""
        return super().execute(statement.replace("synchronous = FULL", "synchronous = OFF"), *given)


@contextmanager
def in_a_hurry() -> Iterator[None]:
    """Has all stores of this process be written to by such connections."""
    from calrig.store.sqlite import database, file

    def connect(*where: Any, **options: Any) -> sqlite3.Connection:
        return file.connect(*where, **{"factory": Hurried, **options})

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(database, "connect", connect)
        yield
