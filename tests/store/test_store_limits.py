"""Limits in the store: in their order, with the runs that they match, and in the trail."""

from __future__ import annotations

from calrig.calibration.uncertainty.conformity import Limit

FLIGHT = Limit(name="flight", units="AS-*", max_error_deg=0.3, rule="guarded")
ALL = Limit(name="all", bias_deg=(-1.0, 1.0), scale=(0.99, 1.01))


def test_limits_come_back_in_their_order(store):
    store.replace_limits([FLIGHT, ALL], who="ada")
    assert store.limits() == [FLIGHT, ALL]
    store.replace_limits([ALL, FLIGHT], who="ben")
    assert store.limits() == [ALL, FLIGHT]


def test_the_trail_says_who_changed_which_and_nothing_where_nothing_changed(store):
    store.replace_limits([FLIGHT], who="ada")
    store.replace_limits([FLIGHT], who="ben")
    (entry,) = store.trail(what=["limits_changed"])
    assert (entry.act.who, entry.act.detail) == (
        "ada",
        {"before": [], "now": [FLIGHT.model_dump(mode="json")]},
    )
    assert store.broken_link() is None


def test_a_run_with_a_result_has_the_limit_that_matches_its_unit_now(store, new_run, result):
    store.replace_limits([FLIGHT, ALL], who=None)
    ended = new_run(unit="AS-1", status="completed", result=result)
    assert (ended.limit, new_run(unit="AS-1").limit) == (FLIGHT, None)
    assert new_run(unit="B", status="completed", result=result).limit == ALL
    store.replace_limits([], who=None)
    runs, _ = store.runs()
    assert [run.limit for run in runs] == [None] * 3
