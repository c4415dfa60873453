from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from empty_store import lay_empty_store
from filled_unit import archive, fill

from calrig.errors import InputError
from calrig.export.archive.check import Checked, check_archive
from calrig.store import Store


@pytest.fixture(scope="session")
def filled(tmp_path_factory: pytest.TempPathFactory) -> str:
    """URL of a store that is not changed."""
    path = tmp_path_factory.mktemp("archive") / "calrig.db"
    lay_empty_store(path)
    with Store.open(f"sqlite:///{path}", writer="test") as store:
        fill(store)
    return f"sqlite:///{path}"


@pytest.fixture(scope="session")
def whole(filled: str) -> bytes:
    """The archive of its unit."""
    with Store.open(filled, writer=None) as store:
        return archive(store)


@pytest.fixture(scope="session")
def check(tmp_path_factory: pytest.TempPathFactory) -> Callable[[bytes], Checked]:
    """Checks bytes as a file; what is no zip at all counts as one problem."""
    path: Path = tmp_path_factory.mktemp("checked") / "unit.zip"

    def look(content: bytes) -> Checked:
        path.write_bytes(content)
        try:
            return check_archive(path)
        except InputError as error:
            return Checked([("the file", str(error))])

    return look
