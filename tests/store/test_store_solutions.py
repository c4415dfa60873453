"""Joint solutions are kept as they were found, and listed the newest first."""

from __future__ import annotations

from dataclasses import replace

import pytest
from rich_store import SOLVED

from calrig.store import NotFound


def test_a_solution_comes_back_as_it_was_kept(store):
    kept = store.solutions.save(SOLVED, by="ada")
    assert store.solutions.get(kept.id) == kept
    assert kept.found == SOLVED
    with pytest.raises(NotFound, match="no solution 'other'"):
        store.solutions.get("other")


def test_solutions_are_listed_by_rig_the_newest_first(store):
    unknown = {**SOLVED.document, "separable": True, "before": {"held_out_rms_deg": None}}
    first = store.solutions.save(SOLVED)
    elsewhere = store.solutions.save(replace(SOLVED, rig=None))
    last = store.solutions.save(replace(SOLVED, document=unknown), by="ada")
    assert [one.id for one in store.solutions.newest()] == [last.id, elsewhere.id, first.id]
    assert [one.id for one in store.solutions.newest(limit=1)] == [last.id]
    assert [
        (one.by, one.basis, one.separable, one.before_rms_deg, one.final_rms_deg)
        for one in store.solutions.newest("r")
    ] == [("ada", SOLVED.basis, True, None, 0.031), (None, SOLVED.basis, False, 0.21, 0.031)]
