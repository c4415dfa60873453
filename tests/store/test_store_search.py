"""Runs that somebody looks for: by part of a serial or a note, by date, by what they are."""

from __future__ import annotations

from datetime import timedelta

import pytest

from calrig.store.runs import Sought


@pytest.fixture
def runs(store):
    """Ids by the name of the run."""

    def make(name: str, **more):
        given = {"unit": name, "rig": "r", "plan": {"kind": "calibration"}, "status": "completed", **more}
        return store.runs.create(provenance={}, **given).id

    first = make("AS-0042", note="Gehäuse 100% dicht", plan={"kind": "verification"})
    return {
        "first": first,
        "second": make("as_0042"),
        "follow-up": make("B", follows=first),
        "static": make("C", plan={"kind": "static"}, rig="other"),
        "import": make("D", plan=None, rig=None),
    }


@pytest.mark.parametrize(
    ("sought", "names"),
    [
        (Sought(text="S-00"), ["first"]),
        (Sought(text="As"), ["second", "first"]),
        (Sought(text="s_0"), ["second"]),  # _ is text
        (Sought(text="0%"), ["first"]),  # and so is %
        (Sought(text="GEHÄUSE"), ["first"]),
        (Sought(text="as", rig="other"), []),
        (Sought(text="as", status="completed", kind="verification"), ["first"]),
        (Sought(kind="calibration"), ["second"]),
        (Sought(kind="static"), ["static"]),
        (Sought(kind="import"), ["import"]),
        (Sought(kind="follow-up"), ["follow-up"]),
    ],
)
def test_runs_are_found_by_what_they_say_and_are(store, runs, sought, names):
    found, cursor = store.runs.search(sought)
    assert ([run.id for run in found], cursor) == ([runs[name] for name in names], None)


def test_runs_are_found_by_when_they_were_made_and_by_what_they_follow(store, runs):
    second = store.runs.get(runs["second"]).created_at
    within = Sought(since=second, before=second + timedelta(microseconds=1))
    assert [run.id for run in store.runs.search(within)[0]] == [runs["second"]]
    assert [run.id for run in store.runs.search(Sought(before=second))[0]] == [runs["first"]]
    followed = store.runs.search(Sought(follows=runs["first"]))[0]
    assert [run.id for run in followed] == [runs["follow-up"]]


def test_what_is_sought_goes_on_page_by_page(store, runs):
    page, cursor = store.runs.search(Sought(text="as"), limit=1)
    rest, last = store.runs.search(Sought(text="as"), limit=1, cursor=cursor)
    assert ([run.id for run in (*page, *rest)], last) == ([runs["second"], runs["first"]], None)
