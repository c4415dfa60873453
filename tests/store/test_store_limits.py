"""Limits in the store: in their order, with the runs that they match, and in the trail."""

from __future__ import annotations

from calrig.calibration.uncertainty.conformity import Limit

FLIGHT = Limit(name="flight", units="AS-*", max_error_deg=0.3, rule="guarded")
ALL = Limit(name="all", bias_deg=(-1.0, 1.0), scale=(0.99, 1.01))


def test_limits_come_back_in_their_order(store):
    store.limits.replace([FLIGHT, ALL], who="ada")
    assert store.limits.all() == [FLIGHT, ALL]
    store.limits.replace([ALL, FLIGHT], who="ben")
    assert store.limits.all() == [ALL, FLIGHT]


def test_the_trail_says_who_changed_which_and_nothing_where_nothing_changed(store):
    store.limits.replace([FLIGHT], who="ada")
    store.limits.replace([FLIGHT], who="ben")
    (entry,) = store.trail.entries(what=["limits_changed"])
    assert (entry.act.who, entry.act.detail) == (
        "ada",
        {"before": [], "now": [FLIGHT.model_dump(mode="json")]},
    )
    assert store.trail.broken_link() is None


def test_a_run_with_a_result_has_the_limit_that_matches_its_unit_now(store, new_run, result):
    store.limits.replace([FLIGHT, ALL], who=None)
    ended = new_run(unit="AS-1", status="completed", result=result)
    assert (ended.limit, new_run(unit="AS-1").limit) == (FLIGHT, None)
    assert new_run(unit="B", status="completed", result=result).limit == ALL
    store.limits.replace([], who=None)
    runs, _ = store.runs.page()
    assert [run.limit for run in runs] == [None] * 3
