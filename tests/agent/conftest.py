"""A bench of one rig, and a database in which its orders are written by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from a_bench import Cable, HandWritten, Rig, hand_written, rigs_of


@pytest.fixture
def rig() -> Iterator[Rig]:
    """One fast rig, `bench-1`."""
    with rigs_of("bench-1") as (rig,):
        yield rig


@pytest.fixture
def centre(new_database: Callable[[], str]) -> Iterator[HandWritten]:
    """A database with the bench in it."""
    with hand_written(new_database()) as centre:
        yield centre


@pytest.fixture
def cable(centre: HandWritten) -> Iterator[Cable]:
    """Between the bench and the database."""
    with closing(Cable(centre.bench_url)) as cable:
        yield cable


@pytest.fixture
def spool(tmp_path: Path) -> Path:
    """Where the bench's spool lies."""
    return tmp_path / "spool.db"
