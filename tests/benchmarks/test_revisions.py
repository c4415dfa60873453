"""How long the revisions of a unit's page take: a hundred, over twenty runs, with what has changed since."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from empty_store import lay_empty_store

from calrig.analysis.amendments import Records
from calrig.analysis.revisions import Issuer
from calrig.store import Store

ROWS = [f"{x},{0.8 + 1.001 * x}" for _ in range(4) for x in range(-60, 61, 10)]
CSV = "\n".join(["target_deg,reading_deg", *ROWS, ""]).encode()
REVISIONS, RUNS = 100, 20


@pytest.fixture
def store(tmp_path: Path):
    path = tmp_path / "calrig.db"
    lay_empty_store(path)
    with Store.open(f"sqlite:///{path}", writer="bench") as opened:
        records = Records(opened)
        runs = [
            records.import_poses(unit="A", rig="bench", file_name="p.csv", content=CSV).id
            for _ in range(RUNS)
        ]
        issuer = Issuer(opened)
        for k in range(REVISIONS - RUNS):
            issuer.draft("A", runs[k % RUNS], reason="once more")
        yield opened


def test_a_hundred_revisions_are_listed(benchmark, store):
    """As `GET /api/units/A/calibrations` does: aim 150 ms for the whole page."""
    issuer = Issuer(store)
    assert len(benchmark(lambda: issuer.listed(store.revisions.of("A")))) == REVISIONS
