"""What is undone: void and exclusion taken back, runs moved to the right unit, accepted effects withdrawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from calrig.analysis.amendments import Records
from calrig.analysis.diagnoses import Acceptance
from calrig.analysis.errors import Conflict, Invalid
from calrig.analysis.results import refitted
from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.plan import Plan
from calrig.store import Run, Store
from calrig.store.errors import NotFound, Refused

Z_MG = 60.0


def sensed_deg(theta_deg: float) -> float:
    """What a sensor whose z has an offset reads."""
    felt = math.radians(0.5 + 1.01 * theta_deg)
    return math.degrees(math.atan2(math.sin(felt), math.cos(felt) + 1e-3 * Z_MG))


POSES = [Pose(theta, sensed_deg(theta) + 0.02 * (-1) ** k) for k, theta in enumerate(range(-60, 61, 10))]


@pytest.fixture
def records(store: Store) -> Records:
    return Records(store)


@pytest.fixture
def new_run(store: Store) -> Callable[..., Run]:
    """A completed calibration of unit WRONG."""

    def make(**given: Any) -> Run:
        usual = {"unit": "WRONG", "rig": "bench-1", "plan": Plan().model_dump(mode="json"), "provenance": {}}
        result = build_result(POSES).to_dict()
        return store.runs.create(
            **{**usual, "status": "completed", "poses": POSES, "result": result, **given}
        )

    return make


def figures(run: Run) -> dict[str, Any]:
    """A run's result without what is said of its latest draft."""
    assert run.result is not None
    return run.result.model_dump(exclude={"doubts"})


def told(store: Store, **asked: Any) -> list[tuple[Any, ...]]:
    """What the trail says of acts after the runs were made, but for the drafts that they led to."""
    acts = store.trail.entries(**asked)
    left_out = ("started", "drafted", "released")
    return [(a.what, a.who, a.run_id, a.reason) for a in acts if a.what not in left_out]


def last_detail(store: Store) -> dict[str, Any]:
    """What the trail says beside of the last of them."""
    acts = store.trail.entries()
    return [act.detail for act in acts if act.what not in ("drafted", "released")][-1]


class TestUndone:
    """Void and exclude, and back."""

    def test_a_run_counts_again_as_if_it_had_never_been_voided(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        run = new_run()
        compared = store.units.comparison(["WRONG"])
        records.void(run.id, "slipped", who="ada")
        assert store.units.comparison(["WRONG"]) == []
        assert records.unvoid(run.id, "it was the other run", who="ben") == run
        assert store.units.comparison(["WRONG"]) == compared
        assert told(store) == [
            ("voided", "ada", run.id, "slipped"),
            ("unvoided", "ben", run.id, "it was the other run"),
        ]
        assert last_detail(store) == {"voided": "slipped"}

    def test_a_pose_counts_again_and_the_result_is_what_it_was(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        run = new_run()
        assert records.exclude_pose(run.id, 3, "bumped", who="ada").result != run.result
        assert figures(records.include_pose(run.id, 3, who="ada")) == figures(run)
        assert [pose.excluded for pose in store.poses.of(run.id)] == [None] * len(POSES)
        assert told(store) == [("excluded", "ada", run.id, "bumped"), ("included", "ada", run.id, None)]
        assert last_detail(store) == {"pose": 3, "excluded": "bumped"}

    def test_what_was_not_done_cannot_be_undone(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        run = new_run()
        with pytest.raises(Refused, match="is not voided"):
            records.unvoid(run.id, "why not")
        with pytest.raises(Refused, match=f"pose 3 of run {run.id} is not excluded"):
            records.include_pose(run.id, 3)
        assert told(store) == []


class TestNotes:
    """Added later."""

    def test_a_note_goes_below_the_one_before_with_who_and_when(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        run = new_run(note="new cable", status="running")
        noted = records.note(run.id, " it hangs low ", who="ada").note
        assert noted is not None
        first, second = noted.split("\n")
        assert first == "new cable"
        at = store.trail.entries()[-1].at
        assert second == f"{at:%Y-%m-%d %H:%M} UTC, ada: it hangs low"

    def test_the_first_note_stands_as_it_was_given(
        self, new_run: Callable[..., Run], records: Records
    ) -> None:
        assert records.note(new_run().id, "it hangs low").note == "it hangs low"

    @pytest.mark.parametrize("note", [" ", "x" * 50_001])
    def test_nothing_and_too_much_are_refused(
        self, new_run: Callable[..., Run], records: Records, note: str
    ) -> None:
        with pytest.raises(Invalid, match="note"):
            records.note(new_run().id, note)


class TestMoved:
    """A serial number corrected."""

    def test_the_run_is_in_the_right_units_history_and_both_trails_tell(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        run, stays = new_run(), new_run()
        moved = records.move(run.id, "RIGHT", "misread", who="ada")
        assert (moved.unit, figures(moved)) == ("RIGHT", figures(run))
        assert [row.run_id for row in store.units.comparison(["RIGHT"])] == [run.id]
        assert [row.run_id for row in store.units.comparison(["WRONG"])] == [stays.id]
        for unit in ("WRONG", "RIGHT"):
            assert told(store, unit=unit) == [("moved", "ada", run.id, "misread")]
        assert last_detail(store) == {"from": "WRONG", "to": "RIGHT"}
        assert told(store, unit="ELSE") == []

    def test_its_result_is_with_what_is_accepted_for_the_right_unit(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        right = diagnosed(store, new_run(unit="RIGHT"), 3.0)
        with_effects = figures(Acceptance(store).accept(right.id, [OFFSET]))
        run = new_run()
        assert run.result is not None
        assert run.result.rms_with_effects_deg is None
        moved = figures(records.move(run.id, "RIGHT", "misread"))
        own, accepted = (one.pop("over_range") for one in (moved, with_effects))
        assert moved == with_effects
        assert (own["bias_deg"], own["scale"]) == (accepted["bias_deg"], accepted["scale"])
        assert own["freedom"] > accepted["freedom"]  # the effect was fitted to the poses of the other run

    def test_follow_ups_move_along(self, new_run: Callable[..., Run], records: Records, store: Store) -> None:
        first = new_run()
        second = new_run(follows=first.id)
        third = new_run(follows=second.id)
        stays = new_run()
        records.move(second.id, "RIGHT", "misread")
        runs, _ = store.runs.page(unit="RIGHT")
        assert [run.id for run in runs] == [third.id, second.id, first.id]
        assert [run.id for run in store.runs.page(unit="WRONG")[0]] == [stays.id]

    def test_an_accepted_effect_is_taken_back_first_and_then_leaves_nothing_behind(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        run = diagnosed(store, new_run(), 3.0)
        Acceptance(store).accept(run.id, [OFFSET])
        words = f"{OFFSET} was accepted from run {run.id} for unit 'WRONG': take it back"
        with pytest.raises(Refused, match=words):
            records.move(run.id, "RIGHT", "misread")
        assert store.units.get("RIGHT") is None
        Acceptance(store).take_back(run.id, [OFFSET], "of another unit")
        records.move(run.id, "RIGHT", "misread")
        (*_, in_force) = [one for one in store.revisions.of("WRONG") if one.status == "in_force"]
        store.revisions.withdraw("WRONG", in_force.revision, "ada", "there is no such unit")
        store.units.remove("WRONG")
        assert [unit.serial for unit in store.units.all()] == ["RIGHT"]

    def test_a_diagnosis_shared_with_runs_that_stay_is_in_the_way(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        first, second = new_run(), new_run()
        store.runs.update(second.id, diagnosis={"runs": [first.id, second.id], "effects": []})
        for run in (first, second):
            with pytest.raises(Conflict, match=f"diagnose run {second.id} alone first"):
                records.move(run.id, "RIGHT", "misread")
        store.runs.update(second.id, diagnosis={"runs": [second.id], "effects": []})
        assert records.move(first.id, "RIGHT", "misread").unit == "RIGHT"

    def test_not_while_it_goes_on_nor_to_where_it_is_nor_a_verification(
        self, new_run: Callable[..., Run], records: Records
    ) -> None:
        with pytest.raises(Conflict, match="running: end it first"):
            records.move(new_run(status="running").id, "RIGHT", "misread")
        with pytest.raises(Conflict, match="of unit 'WRONG' already"):
            records.move(new_run().id, "WRONG", "misread")
        verification = Plan(kind="verification").model_dump(mode="json")
        with pytest.raises(Conflict, match="is a verification"):
            records.move(new_run(plan=verification).id, "RIGHT", "misread")
        with pytest.raises(Invalid, match="serial number"):
            records.move(new_run().id, " RIGHT", "misread")


class TestRemoved:
    """Units that nothing is known of."""

    def test_an_empty_unit_is_removed_and_one_with_runs_stays(
        self, new_run: Callable[..., Run], records: Records, store: Store
    ) -> None:
        run = new_run()
        with pytest.raises(Refused, match="'WRONG' has runs"):
            store.units.remove("WRONG")
        records.move(run.id, "RIGHT", "misread")
        store.units.remove("WRONG", who="ada")
        assert store.units.get("WRONG") is None
        assert told(store, unit="WRONG")[-1] == ("unit_removed", "ada", None, None)
        with pytest.raises(NotFound):
            store.units.remove("WRONG")


OFFSET = "accelerometer_offset"


def diagnosed(store: Store, run: Run, z_mg: float) -> Run:
    """The run with a diagnosis that names an offset, as far as accepting it looks."""
    effect = {
        "name": OFFSET,
        "verdict": "named",
        "origin": "sensor",
        "parameters": {"y_mg": {"value": 0.0, "std": 0.1}, "z_mg": {"value": z_mg, "std": 0.1}},
        "confusable_with": [],
        "changed": None,
        "remedy": "subtract the offsets",
    }
    return store.runs.update(run.id, diagnosis={"runs": [run.id], "effects": [effect]})


def in_force(store: Store) -> dict[str, float | None]:
    return {
        effect.name: effect.parameters.get("z_mg") for effect in store.effects.in_force("WRONG", "bench-1")
    }


class TestTakenBack:
    """Effects that were accepted."""

    def test_what_was_in_force_before_is_so_again_and_the_result_follows(
        self, new_run: Callable[..., Run], store: Store
    ) -> None:
        acceptance = Acceptance(store)
        again = [
            replace(pose, reading_deg=pose.reading_deg - 0.04 * (-1) ** k) for k, pose in enumerate(POSES)
        ]
        first, second = diagnosed(store, new_run(), 3.0), diagnosed(store, new_run(poses=again), 6.0)
        acceptance.accept(first.id, [OFFSET])
        before = store.runs.update(second.id, result=refitted(store, store.runs.get(second.id), again))
        accepted = acceptance.accept(second.id, [OFFSET], who="ada")
        assert in_force(store) == {OFFSET: pytest.approx(Z_MG, abs=1.0)}, "as the poses of both have it"
        assert accepted.diagnosis is not None
        assert accepted.diagnosis["effects"][0]["accepted_at"] is not None

        back = acceptance.take_back(second.id, [OFFSET], "of a loose cable", who="ben")
        assert in_force(store) == {OFFSET: 3.0}
        assert store.effects.names_by_unit() == {"WRONG": [OFFSET]}
        assert back.result == before.result != accepted.result
        assert back.diagnosis is not None
        assert back.diagnosis["effects"][0]["accepted_at"] is None
        assert told(store)[-1] == ("taken_back", "ben", second.id, "of a loose cable")

        acceptance.take_back(first.id, [OFFSET], "so was this")
        assert in_force(store) == store.effects.names_by_unit() == {}

    def test_what_is_not_accepted_from_the_run_is_not_taken_back(
        self, new_run: Callable[..., Run], store: Store
    ) -> None:
        first, second = diagnosed(store, new_run(), 3.0), diagnosed(store, new_run(), 6.0)
        Acceptance(store).accept(first.id, [OFFSET])
        with pytest.raises(Refused, match=f"{OFFSET} is not accepted from run {second.id}"):
            Acceptance(store).take_back(second.id, [OFFSET], "why not")
        with pytest.raises(Refused, match=f"backlash is not accepted.*accepted from it: {OFFSET}"):
            Acceptance(store).take_back(first.id, [OFFSET, "backlash"], "why not")
        assert in_force(store) == {OFFSET: 3.0}
        Acceptance(store).take_back(first.id, [OFFSET], "why not")
        with pytest.raises(Refused, match="accepted from it: none"):
            Acceptance(store).take_back(first.id, [OFFSET], "why not")

    def test_only_what_is_named_is_taken_back(self, new_run: Callable[..., Run], store: Store) -> None:
        run = diagnosed(store, new_run(), 3.0)
        assert run.diagnosis is not None
        (effect,) = run.diagnosis["effects"]
        gain = {"gain_pct": {"value": 0.1, "std": 0.01}, "skew_deg": None}
        both = [effect, {**effect, "name": "axis_mismatch", "parameters": gain}]
        store.runs.update(run.id, diagnosis={**run.diagnosis, "effects": both})
        Acceptance(store).accept(run.id, [OFFSET, "axis_mismatch"])
        back = Acceptance(store).take_back(run.id, ["axis_mismatch"], "why not")
        assert list(in_force(store)) == [OFFSET]
        assert back.diagnosis is not None
        assert [one["accepted_at"] is None for one in back.diagnosis["effects"]] == [False, True]

    def test_accepted_once_more_it_is_in_force_once_more(
        self, new_run: Callable[..., Run], store: Store
    ) -> None:
        run = diagnosed(store, new_run(), 3.0)
        for _ in range(2):
            Acceptance(store).accept(run.id, [OFFSET])
        Acceptance(store).take_back(run.id, [OFFSET], "why not")
        assert in_force(store) == {}
        Acceptance(store).accept(run.id, [OFFSET])
        assert in_force(store) == {OFFSET: 3.0}
