"""A rig's map: one in force at a time, each change in the trail."""

from __future__ import annotations

import pytest
from rich_store import SOLVED

from calrig.store import NotFound


def test_one_map_is_in_force_for_a_rig_until_it_is_withdrawn(store):
    solution = store.keep_solution(SOLVED)
    assert store.stage_map("r") is None
    first = store.put_stage_map("r", solution.id, SOLVED.stage_map, who="ada")
    other = {**SOLVED.stage_map, "sha256": "60" * 32}
    second = store.put_stage_map("r", solution.id, other)
    assert store.stage_map("r") == second
    assert (first.document, first.put_by, second.document) == (SOLVED.stage_map, "ada", other)
    assert store.stage_map("another") is None
    store.withdraw_stage_map("r", "the gear was changed", who="ada")
    assert store.stage_map("r") is None
    with pytest.raises(NotFound, match="no stage's map in force"):
        store.withdraw_stage_map("r", "once more")
    acts = [entry.act for entry in store.trail(what=["map_put_in_force", "map_withdrawn"])]
    assert [(act.what, act.rig, act.detail["sha256"][:2]) for act in acts] == [
        ("map_put_in_force", "r", "5f"),
        ("map_put_in_force", "r", "60"),
        ("map_withdrawn", "r", "60"),
    ]
    assert store.broken_link() is None
