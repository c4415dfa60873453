"""Joint solutions are kept as they were found, and listed the newest first."""

from __future__ import annotations

from dataclasses import replace

import pytest
from rich_store import SOLVED

from calrig.store import NotFound


def test_a_solution_comes_back_as_it_was_kept(store):
    kept = store.keep_solution(SOLVED, by="ada")
    assert store.solution(kept.id) == kept
    assert kept.found == SOLVED
    with pytest.raises(NotFound, match="no solution 'other'"):
        store.solution("other")


def test_solutions_are_listed_by_rig_the_newest_first(store):
    unknown = {**SOLVED.document, "separable": True, "before": {"held_out_rms_deg": None}}
    first = store.keep_solution(SOLVED)
    elsewhere = store.keep_solution(replace(SOLVED, rig=None))
    last = store.keep_solution(replace(SOLVED, document=unknown), by="ada")
    assert [one.id for one in store.solutions()] == [last.id, elsewhere.id, first.id]
    assert [one.id for one in store.solutions(limit=1)] == [last.id]
    assert [
        (one.by, one.basis, one.separable, one.before_rms_deg, one.final_rms_deg)
        for one in store.solutions("r")
    ] == [("ada", SOLVED.basis, True, None, 0.031), (None, SOLVED.basis, False, 0.21, 0.031)]
