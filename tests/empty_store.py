"""An empty store's file, made once by the migrations and copied ever after."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory


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
