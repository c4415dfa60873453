"""An amendment and all that follows from it are one transaction; half-done ones of before are completed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from postgresql_server import store_at
from studies.accepting import EFFECTS, FIRST_C, SECOND_C, UNIT, diagnosed_run, measured

from calrig.analysis import unit_of_work
from calrig.analysis.amendments import Records
from calrig.analysis.diagnoses import Acceptance
from calrig.analysis.errors import Conflict
from calrig.analysis.mending import mend
from calrig.analysis.results import refitted
from calrig.analysis.revisions import Issuer, Releases
from calrig.store import AcceptedEffect, Run, Store

OFFSET, WARMTH = (name for name, _ in EFFECTS)
WHY = "as a test"


class Killed(BaseException):
    """The end of the process, as far as a transaction can tell."""


class Dying(Issuer):
    """An issuer that is killed before it makes a draft."""

    def redraft(self, changed: Run, *, by: str | None, reason: str) -> None:
        """Dies."""
        raise Killed


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with one accepted effect, a draft, and an excluded pose."""
    path = tmp_path_factory.mktemp("run") / "calrig.db"
    with Store.open(store_at(path), writer="tests") as store:
        made = diagnosed_run(store, measured(np.random.default_rng(3), FIRST_C), OFFSET, WARMTH)
        Acceptance(store).accept(made.id, [OFFSET])
        Records(store).exclude_pose(made.id, 5, WHY)
    return path


@pytest.fixture
def run(filled: Path, store: Store) -> Run:
    """That run, in a store that is the test's own."""
    ((made,), _) = store.runs.page(limit=1)
    return made


def state(store: Store) -> list[Any]:
    """All that the acts change."""
    runs, _ = store.runs.page(limit=99)
    units = [one.serial for one in store.units.all()]
    return [
        runs,
        units,
        [store.poses.of(one.id) for one in runs],
        [store.effects.in_force(unit, "bench-1") for unit in units],
        [store.revisions.of(unit) for unit in units],
        store.trail.entries(),
    ]


@pytest.mark.parametrize(
    "act",
    [
        lambda run, records, acceptance: acceptance.accept(run.id, [WARMTH]),
        lambda run, records, acceptance: acceptance.take_back(run.id, [OFFSET], WHY),
        lambda run, records, acceptance: records.exclude_pose(run.id, 7, WHY),
        lambda run, records, acceptance: records.include_pose(run.id, 5, WHY),
        lambda run, records, acceptance: records.void(run.id, WHY),
    ],
    ids=["accept", "withdraw", "exclude", "include", "void"],
)
def test_an_act_that_is_killed_before_its_draft_leaves_nothing(
    store: Store, run: Run, act: Callable[[Run, Records, Acceptance], Run]
) -> None:
    before, dying = state(store), Dying(store)
    with pytest.raises(Killed):
        act(run, Records(store, dying), Acceptance(store, dying))
    assert state(store) == before
    act(run, Records(store), Acceptance(store))
    assert state(store) != before


@pytest.mark.parametrize("undone", ["unvoid", "move"])
def test_an_act_on_a_run_without_effects_that_is_killed_leaves_nothing(store: Store, undone: str) -> None:
    run = diagnosed_run(store, measured(np.random.default_rng(3), FIRST_C))
    if undone == "unvoid":
        Records(store).void(run.id, WHY)
    before, dying = state(store), Records(store, Dying(store))
    with pytest.raises(Killed):
        dying.unvoid(run.id, WHY) if undone == "unvoid" else dying.move(run.id, "AS-9", WHY)
    assert state(store) == before


def test_others_see_the_state_of_before_until_all_of_an_act_is_stored(store: Store, run: Run) -> None:
    seen: list[Any] = []

    class Watched(Issuer):
        def redraft(self, changed: Run, *, by: str | None, reason: str) -> None:
            other = threading.Thread(target=lambda: seen.append(state(store)), daemon=True)
            other.start()
            other.join()

    before = state(store)
    Acceptance(store, Watched(store)).accept(run.id, [WARMTH])
    assert seen == [before]


def test_a_fit_whose_data_changed_in_the_meantime_is_computed_again(
    store: Store, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    second = diagnosed_run(store, measured(np.random.default_rng(4), SECOND_C), WARMTH)
    fitted: list[int] = []

    def meddle(fit: Any) -> Any:
        fitted.append(len(fitted))
        with suppress(StopIteration):
            Records(store).exclude_pose(second.id, next(meddling), WHY)
        return fit()

    monkeypatch.setattr(unit_of_work, "run_in_subprocess", meddle)
    meddling = iter([10])
    Acceptance(store).accept(second.id, [WARMTH])
    assert len(fitted) == 2
    (newest, *_) = store.revisions.of(UNIT)
    assert newest.basis["excluded"] == [10], "the draft rests on the poses that count now"

    Acceptance(store).take_back(second.id, [WARMTH], WHY)
    meddling, before = iter(range(20, 40)), len(store.effects.in_force(UNIT, None))
    with pytest.raises(Conflict, match="repeat"):
        Acceptance(store).accept(second.id, [WARMTH])
    assert len(store.effects.in_force(UNIT, None)) == before


class TestMending:
    """Half states that earlier versions left."""

    @staticmethod
    def accept_half(store: Store, run: Run, *, with_result: bool = False) -> None:
        """What an earlier version had stored when it was killed."""
        parameters = {"deg_per_c": 0.0115, "reference_c": 26.0}
        effect = AcceptedEffect(run.id, UNIT, None, WARMTH, "sensor", parameters, runs=[run.id])
        store.effects.accept(run.id, [effect])

    def test_an_acceptance_gets_the_result_and_the_draft_that_it_lacks(self, store: Store) -> None:
        run = diagnosed_run(store, measured(np.random.default_rng(3), FIRST_C), WARMTH)
        Issuer(store).draft(UNIT, run.id)
        self.accept_half(store, run)
        says = mend(store, Issuer(store))
        assert len(says) == 2
        assert all(run.id in one for one in says)
        now = store.runs.get(run.id)
        assert now is not None
        assert now.result is not None
        assert now.result.rms_with_effects_deg is not None
        newest, first = store.revisions.of(UNIT)
        assert [one["name"] for one in newest.document["effects"]] == [WARMTH]
        assert (newest.status, first.status) == ("in_force", "superseded")
        told = [entry.reason for entry in store.trail.entries(what=["mended"]) if entry.unit]
        assert told == says
        assert store.trail.broken_link() is None
        assert mend(store, Issuer(store)) == []
        Acceptance(store).take_back(run.id, [WARMTH], WHY)

    def test_a_withdrawal_after_which_the_run_shows_effects_is_completed(self, store: Store) -> None:
        run = diagnosed_run(store, measured(np.random.default_rng(3), FIRST_C), OFFSET, WARMTH)
        Acceptance(store).accept(run.id, [WARMTH])
        store.effects.revoke(run.id, [WARMTH], WHY)
        assert len(mend(store, Issuer(store))) == 2
        now = store.runs.get(run.id)
        assert now is not None
        assert now.result is not None
        assert now.result.rms_with_effects_deg is None
        assert store.revisions.of(UNIT)[0].document["effects"] == []

    @pytest.mark.parametrize("act", ["void", "exclude", "move"])
    def test_a_change_gets_the_draft_that_it_lacks(self, store: Store, act: str) -> None:
        poses = measured(np.random.default_rng(3), FIRST_C)
        earlier, run = diagnosed_run(store, poses), diagnosed_run(store, poses[:26])
        Issuer(store).draft(UNIT, run.id)
        if act == "void":
            store.amendments.void(run.id, WHY)
        elif act == "exclude":
            store.amendments.exclude_pose(run.id, 3, WHY, result=run.result and run.result.to_dict())
        else:
            store.amendments.move({run.id: run.result and run.result.to_dict()}, "AS-9", WHY)
        says = mend(store, Issuer(store))
        drafts = {unit: store.revisions.of(unit)[0].run_id for unit in (UNIT, "AS-9")[: len(says)]}
        expected = {UNIT: run.id if act == "exclude" else earlier.id}
        assert drafts == (expected | {"AS-9": run.id} if act == "move" else expected)

    def test_a_completed_draft_on_a_manual_rig_waits_for_a_person(self, store: Store) -> None:
        run = diagnosed_run(store, measured(np.random.default_rng(3), FIRST_C), WARMTH)
        Issuer(store).draft(UNIT, run.id)
        self.accept_half(store, run)
        mend(store, Issuer(store, Releases({"bench-1": "manual"})))
        assert [one.status for one in store.revisions.of(UNIT)] == ["draft", "in_force"]

    def test_a_whole_change_without_a_draft_stays_as_it_is_whatever_followed(self, store: Store) -> None:
        """Effects of the rig and a joint model that came later change neither its result nor its draft."""
        poses = [measured(np.random.default_rng(k), ends) for k, ends in ((3, FIRST_C), (4, SECOND_C))]
        first, second = (diagnosed_run(store, one, WARMTH) for one in poses)
        Acceptance(store).accept(first.id, [WARMTH])
        Issuer(store).draft(UNIT, second.id)
        unused = diagnosed_run(store, poses[0])
        Records(store).void(unused.id, WHY)  # no revision rests on it: there is no draft
        of_rig = {"name": "backlash", "parameters": {"backlash_deg": 0.02}, "origin": "stage"}
        store.effects.accept(second.id, [AcceptedEffect(second.id, None, "bench-1", **of_rig)])
        before = store.runs.get(first.id), len(store.revisions.of(UNIT))
        assert mend(store, Issuer(store)) == []
        assert (store.runs.get(first.id), len(store.revisions.of(UNIT))) == before

    def test_an_acceptance_whose_draft_was_not_wanted_is_not_fitted_again(self, store: Store) -> None:
        poses = [measured(np.random.default_rng(k), ends) for k, ends in ((3, FIRST_C), (4, SECOND_C))]
        first, second = (diagnosed_run(store, one, WARMTH) for one in poses)
        self.accept_half(store, first)  # whole, but for the draft: a joint solution was in force
        store.runs.update(first.id, result=refitted(store, first, poses[0]))
        Acceptance(store).accept(second.id, [WARMTH])  # the joint model of both
        kept = store.runs.get(first.id)
        says = mend(store, Issuer(store))
        assert not any("its result" in one for one in says)
        assert store.runs.get(first.id) == kept

    def test_a_store_is_checked_once_before_its_own_changes(self, store: Store, run: Run) -> None:
        mend(store, Issuer(store))
        Records(store).void(run.id, WHY)
        before = state(store)
        assert mend(store, Issuer(store)) == []
        assert state(store) == before

    def test_whole_changes_stay_as_they_are(self, store: Store, run: Run) -> None:
        Records(store).void(run.id, WHY)
        before = state(store)
        assert mend(store, Issuer(store)) == []
        assert state(store)[:-1] == before[:-1]
