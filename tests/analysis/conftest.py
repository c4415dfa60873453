"""A store in a file of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from postgresql_server import store_at

from calrig.store import Store


@pytest.fixture
def database(tmp_path: Path) -> Path:
    return tmp_path / "calrig.db"


@pytest.fixture
def store(database: Path, request: pytest.FixtureRequest) -> Iterator[Store]:
    """Empty, or a copy of the module's own `filled`, a path, for tests that ask for that as well."""
    begun = request.getfixturevalue("filled") if "filled" in request.fixturenames else None
    with Store.open(store_at(database, copy_of=begun), writer="tests") as opened:
        yield opened
