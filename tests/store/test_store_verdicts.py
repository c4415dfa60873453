"""Limits in their order, and runs found by their verdict: always those that judging one by one gives."""

from __future__ import annotations

import random
from typing import get_args

import numpy as np
from sqlmodel import update

from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.calibration.uncertainty.budget import Reference
from calrig.calibration.uncertainty.conformity import Limit
from calrig.store import AcceptedEffect
from calrig.store import verdicts as module
from calrig.store.runs import Sought
from calrig.store.tables import VerdictFiguresTable
from calrig.store.verdicts import Judged

STAGE, PLANS = Reference(0.029, "harmonic"), [{"kind": "calibration"}, {"kind": "verification"}, None]
LIMITS = [
    Limit(name="error", units="A*", max_error_deg=0.12, rule="guarded"),
    Limit(name="line", rig="r", bias_deg=(-1.0, 1.0), scale=(0.99, 1.01), rule="guarded"),
    Limit(name="rms", rms_deg=0.05, expanded_uncertainty_deg=0.055),
    Limit(name="scale", units="?", scale=(1.0015, 1.0025)),
]


def result(bent_deg=0.0, reference=STAGE, theta=range(-60, 61, 10), noise_deg=0.005, **given):
    """What a sweep up and down gives of a unit whose readings are bent."""
    at = np.array([*theta, *reversed(theta)], dtype=float)
    wobble = np.random.default_rng(0).normal(0.0, 0.005, len(at))
    reading = 0.8 + 1.002 * at + bent_deg * np.cos(np.radians(6.0 * at)) + wobble
    poses = [
        Pose(target_deg=float(a), reading_deg=float(r), reading_stderr_deg=noise_deg)
        for a, r in zip(at, reading, strict=True)
    ]
    return {**build_result(poses, None, (), reference).to_dict(), **given}


RESULTS = [
    None,
    result(),
    result(0.08),
    result(0.12),
    result(0.2),
    result(0.02, reference=None),
    result(theta=[5.0] * 9),
    result(noise_deg=None),
    result(rms_with_effects_deg=0.0055),
    result(over_range=None),
    result(over_range=None, rms_calibrated_deg=None),
]
EFFECT = {"name": "backlash", "verdict": "named", "parameters": {"backlash_deg": {"value": 0.1, "std": 0.01}}}
DIAGNOSIS = {"effects": [{**EFFECT, "confusable_with": []}], "noise": {}}


def something_changes(store, run_id, chance):
    """One of all that can change a verdict, or that should not."""
    accepted = AcceptedEffect(run_id, None, "r", "backlash", "stage", {"backlash_deg": 0.1})
    return chance.choice(
        [
            lambda: store.limits.replace(chance.sample(LIMITS, chance.randint(0, 4)), who=None),
            lambda: store.runs.update(run_id, result=chance.choice(RESULTS)),
            lambda: store.runs.update(run_id, faults={"move_mismatch": chance.randint(0, 1)}),
            lambda: store.runs.update(run_id, diagnosis=DIAGNOSIS),
            lambda: store.effects.accept(run_id, [accepted]),
            lambda: store.amendments.void(run_id, "the cable caught"),
            lambda: store.amendments.move(
                {run_id: chance.choice(RESULTS)}, chance.choice("ABC"), "a wrong label"
            ),
            lambda: chance.random() < 0.3 and another_program_wrote(store),
        ]
    )


def another_program_wrote(store):
    """All figures, and by a rule of its own."""
    with store._database.writing() as session:
        session.exec(update(VerdictFiguresTable).values(program="another one", left="noise", relied_on=True))


def found(store, judged, limit):
    """Ids of all pages; as often as not, what was judged whole on the way is kept."""
    ids, cursor = [], None
    while True:
        page = store.verdicts.judged_runs(Sought(), judged, limit=limit, cursor=cursor)
        assert len(page.items) <= limit
        ids += [run.id for run in page.items]
        if limit > 2:
            store.verdicts.judge(page.judged_whole)
        cursor = page.next_cursor
        if cursor is None:
            return ids


def test_whatever_a_verdict_follows_from_is_followed(store, new_run):
    """With 24 degrees of freedom only noise is left, with one less, for an effect was fitted, more is."""
    store.limits.replace([LIMITS[2]], who=None)
    near = result(rms_with_effects_deg=1.275 * 0.005 / 1.002)
    run_id = new_run(unit="A", rig="r", plan={"kind": "calibration"}, result=near).id
    accepted = AcceptedEffect(run_id, None, "r", "backlash", "stage", {"backlash_deg": 0.1})
    for change, judged in (
        (lambda: None, {"pass", "noise"}),
        (lambda: store.runs.update(run_id, faults={"move_mismatch": 1}), {"undecided", "noise"}),
        (lambda: store.runs.update(run_id, faults={}, diagnosis=DIAGNOSIS), {"pass", "noise"}),
        (lambda: store.effects.accept(run_id, [accepted]), {"pass", "more_than_noise"}),
        (lambda: store.runs.update(run_id, plan={"kind": "verification"}), {"pass", "noise"}),
        (lambda: store.limits.replace([LIMITS[0]], who=None), {"pass", "noise"}),
        (lambda: store.runs.update(run_id, result=result(0.5)), {"conditional_fail", "more_than_noise"}),
        (lambda: store.amendments.move({run_id: near}, "B", "a wrong label"), {"no_limits", "noise"}),
        (lambda: store.runs.update(run_id, result=None), set()),
    ):
        change()
        assert said(store.runs.get(run_id)) == judged
        assert {one for one in get_args(Judged) if found(store, one, 5)} == judged


def test_a_search_by_verdict_finds_what_judging_one_by_one_does(store, new_run, monkeypatch):
    """Whatever was changed before; sought is what the run that was changed is now, or was."""
    monkeypatch.setattr(module, "LOOKED_AT", 7)
    monkeypatch.setattr(module, "JUDGED_WHOLE", 3)
    chance, runs = random.Random(0), []
    for place, given in enumerate(RESULTS):
        plan, rig = PLANS[place % 3], chance.choice(["r", "s", None])
        runs.append(new_run(unit=chance.choice(["A", "B", "AA"]), plan=plan, rig=rig, result=given).id)
    sought = set()
    for _ in range(50):
        changed = chance.choice(runs)
        was = said(store.runs.get(changed))
        something_changes(store, changed, chance)()
        now = said(store.runs.get(changed))
        judged = chance.choice([*(was ^ now), *(was ^ now), *now] or get_args(Judged))
        expected = [run_id for run_id in reversed(runs) if judged in said(store.runs.get(run_id))]
        assert found(store, judged, chance.randint(1, 5)) == expected
        sought |= {judged} if expected else set()
    assert len(sought) >= 5


def said(run):
    """The verdicts that a run is found by."""
    return set() if run.verdict is None else {run.verdict.answer, run.verdict.left} - {None}


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
    assert (entry.who, entry.detail) == (
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
