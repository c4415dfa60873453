"""Runs found by their verdict after an upgrade: judged whole once, and kept where that can be written."""

from __future__ import annotations

import pytest
from dated_runs import gave, lay
from postgresql_server import store_at
from sqlmodel import update

from calrig.analysis.run_search import found_runs
from calrig.store import Store
from calrig.store.runs import Sought
from calrig.store.tables import VerdictFiguresTable


@pytest.fixture
def store(store_path):
    """Five runs with the figures that another program has written."""
    with Store.open(store_at(store_path), writer="test") as opened:
        lay(opened, *((f"A-{k}", k, gave(rms_calibrated_deg=0.01 * (1 + 4 * (k % 2))), {}) for k in range(5)))
        with opened._database.writing() as session:
            session.exec(update(VerdictFiguresTable).values(program="another one", left=None))
        yield opened


def units(store, judged):
    found = found_runs(store, Sought(), judged, 50, None)
    assert found.next_cursor is None
    return [run.unit for run in found.items]


def test_what_another_program_wrote_is_not_looked_at_and_written_anew(store):
    assert units(store, "noise") == ["A-4", "A-2", "A-0"]
    assert store.verdicts.judged_runs(Sought(), "noise").judged_whole == []
    assert units(store, "more_than_noise") == ["A-3", "A-1"]


def test_a_store_that_is_only_read_is_searched_as_well(store, store_path):
    with Store.open(store_at(store_path), writer=None) as reader:
        assert units(reader, "noise") == ["A-4", "A-2", "A-0"]
        assert len(reader.verdicts.judged_runs(Sought(), "noise").judged_whole) == 5
