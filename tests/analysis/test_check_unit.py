"""A rig held against its check unit, and the runs that a failure puts in doubt."""

from __future__ import annotations

import pytest
from dated_runs import at, gave, lay, ran

from calrig.analysis.check_standard import check_document, suspects, with_doubts
from calrig.analysis.errors import Unknown
from calrig.analysis.histories import histories
from calrig.store import NotFound, Store
from calrig.store.tables import CheckUnitTable

WOBBLE = (0.0, 0.01, -0.01, 0.005, -0.005, 0.008, -0.004)


def history(store: Store, days: int = 7) -> None:
    """The check unit once a day, and two units that were calibrated twice."""
    checks = [("CHECK", float(day), gave(0.8 + WOBBLE[day]), {}) for day in range(days)]
    others = [(unit, day, gave(0.5 + day / 100), {}) for unit in ("A", "B") for day in (0.4, 1.4)]
    lay(store, *checks, *others)


def named(store: Store, day: float = 3, interval_days: float = 2) -> None:
    store.check_standards.name("bench-1", "CHECK", interval_days, who="ada")
    with store._database.writing() as session:
        session.get_one(CheckUnitTable, "bench-1").named_at = at(day)


def test_a_rig_that_keeps_passes_and_is_due_after_its_interval(store: Store) -> None:
    history(store)
    named(store)
    found = check_document(store, "bench-1", now=at(7))
    assert (found["state"], found["overdue"], found["due_at"]) == ("passed", False, at(8))
    assert [one["is_check"] for one in found["checks"]] == [False] * 3 + [True] * 4
    assert found["checks"][0]["verdict"] == "not_known"
    assert {one["verdict"] for one in found["checks"][1:]} == {"passed"}
    assert found["suspect_runs"] == []
    assert check_document(store, "bench-1", now=at(9))["overdue"]


def test_the_runs_since_it_last_passed_are_in_doubt_from_the_moment_it_fails(store: Store) -> None:
    history(store)
    named(store)
    before = ran(store, "A", 5.5)
    during = ran(store, "A", 6.5)
    elsewhere = ran(store, "A", 6.6, rig="bench-2")
    assert suspects(store).of("bench-1", during.finished_at) is None
    failure = ran(store, "CHECK", 7, 1.5)
    after = ran(store, "B", 7.5)
    found = check_document(store, "bench-1", now=at(8))
    assert found["state"] == "failed"
    assert found["last_passed_at"] == at(6)
    assert found["suspect_runs"] == [during.id, failure.id, after.id]
    doubted = [run.suspect for run in with_doubts(store, [before, during, elsewhere, after])]
    assert [one is not None for one in doubted] == [False, True, False, True]
    assert f"failed on rig bench-1 in run {failure.id}" in doubted[1].reason
    assert "2025-01-07" in doubted[1].reason, "the day it last passed"
    ran(store, "CHECK", 9, 0.8)
    later = ran(store, "B", 9.5)
    found = check_document(store, "bench-1", now=at(10))
    assert found["state"] == "passed"
    assert later.id not in found["suspect_runs"]
    assert after.id in found["suspect_runs"]


def test_before_anything_is_known_nothing_is_said(store: Store) -> None:
    ran(store, "CHECK", 0)
    named(store)
    found = check_document(store, "bench-1", now=at(1))
    assert (found["state"], found["suspect_runs"]) == ("not_known", [])


def test_a_rig_without_one_says_what_to_do(store: Store) -> None:
    with pytest.raises(Unknown, match="has no check unit: name one"):
        check_document(store, "bench-1")
    with pytest.raises(NotFound, match="no unit 'nope'"):
        store.check_standards.name("bench-1", "nope", 1)
    with pytest.raises(NotFound, match="has no check unit"):
        store.check_standards.remove("bench-1")
    assert suspects(store, histories(store)).of("bench-1", at(0)) is None


def test_naming_one_is_in_the_trail_and_another_unit_begins_anew(store: Store) -> None:
    for unit in ("CHECK", "OTHER"):
        ran(store, unit, 0)
    named(store)
    kept = store.check_standards.name("bench-1", "CHECK", 5)
    assert (kept.named_at, kept.interval_days) == (at(3), 5)
    assert store.check_standards.name("bench-1", "OTHER", 5).named_at > at(3)
    store.check_standards.remove("bench-1", who="ada")
    assert store.check_standards.all() == []
    acts = store.trail.entries(what=["check_unit_changed"])
    assert [(act.who, act.rig, act.detail["unit"]) for act in acts] == [
        ("ada", "bench-1", "CHECK"),
        (None, "bench-1", "CHECK"),
        (None, "bench-1", "OTHER"),
        ("ada", "bench-1", None),
    ]


def test_a_jump_is_seen_however_few_the_repeats_where_they_are_as_alike_as_their_noise(store: Store) -> None:
    """Three runs that repeat to the last digit, and one that is off by fifty standard errors."""
    for day in range(3):
        ran(store, "CHECK", day, 0.8)
    named(store, day=1)
    other = ran(store, "A", 2.5)
    ran(store, "CHECK", 3, 0.9)
    found = check_document(store, "bench-1", now=at(4))
    assert (found["state"], other.id in found["suspect_runs"]) == ("failed", True)
