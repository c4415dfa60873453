"""Joint solutions as they were found, and the map of one in force for a rig."""

from __future__ import annotations

from dataclasses import asdict, replace

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
    listed = store.solutions.newest("r")
    rms_deg = [(one.before.held_out_rms_deg, one.final.held_out_rms_deg) for one in listed]
    assert [(one.by, one.separable) for one in listed] == [("ada", True), (None, False)]
    assert rms_deg == [(None, 0.031), (0.21, 0.031)]
    basis = {name: list(one) if isinstance(one, tuple) else one for name, one in asdict(SOLVED.basis).items()}
    assert all(one.model_dump(include=basis.keys()) == basis for one in listed)


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
    acts = store.trail.entries(what=["map_put_in_force", "map_withdrawn"])
    assert [(act.what, act.rig, act.detail["sha256"][:2]) for act in acts] == [
        ("map_put_in_force", "r", "5f"),
        ("map_put_in_force", "r", "60"),
        ("map_withdrawn", "r", "60"),
    ]
    assert store.trail.broken_link() is None
