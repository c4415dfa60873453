"""A rig's map: one in force at a time, each change in the trail."""

from __future__ import annotations

import pytest
from rich_store import SOLVED

from calrig.store import NotFound


def test_one_map_is_in_force_for_a_rig_until_it_is_withdrawn(store):
    solution = store.solutions.save(SOLVED)
    assert store.stage_maps.of("r") is None
    first = store.stage_maps.put_in_force("r", solution.id, SOLVED.stage_map, who="ada")
    other = {**SOLVED.stage_map, "sha256": "60" * 32}
    second = store.stage_maps.put_in_force("r", solution.id, other)
    assert store.stage_maps.of("r") == second
    assert (first.document, first.put_by, second.document) == (SOLVED.stage_map, "ada", other)
    assert store.stage_maps.of("another") is None
    store.stage_maps.withdraw("r", "the gear was changed", who="ada")
    assert store.stage_maps.of("r") is None
    with pytest.raises(NotFound, match="no stage's map in force"):
        store.stage_maps.withdraw("r", "once more")
    acts = [entry.act for entry in store.trail.entries(what=["map_put_in_force", "map_withdrawn"])]
    assert [(act.what, act.rig, act.detail["sha256"][:2]) for act in acts] == [
        ("map_put_in_force", "r", "5f"),
        ("map_put_in_force", "r", "60"),
        ("map_withdrawn", "r", "60"),
    ]
    assert store.trail.broken_link() is None
