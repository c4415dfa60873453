"""Who is next in a list: from its turns and what became of their runs."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest

from calrig.calibration.results import UNKNOWN_GYRO
from calrig.calibration.uncertainty.conformity import Limit
from calrig.model.result import Result
from calrig.model.run import Progress
from calrig.runs.batches import settled, word_of
from calrig.store import Run
from calrig.store.batches import Turn

NOW = datetime(2026, 11, 22, tzinfo=UTC)
RESULT = Result(
    bias_deg=0.1,
    bias_std_deg=0.01,
    scale=1.0,
    scale_std=1e-4,
    rms_raw_deg=0.1,
    rms_calibrated_deg=0.1,
    rms_with_effects_deg=None,
    n_poses=8,
    noise_deg=0.1,
    temperature_c=None,
    gyro=UNKNOWN_GYRO,
)


def run(run_id: str, status: Any = "completed", bias_limit_deg: float | None = None, **more: Any) -> Run:
    limit = None if bias_limit_deg is None else Limit(name="l", bias_deg=(-bias_limit_deg, bias_limit_deg))
    done = Progress(poses_done=8, poses_total=8, fraction=1.0, remaining_s=0.0)
    made = Run(
        id=run_id, unit="A", rig="r", status=status, plan={}, progress=done, result=None, diagnosis=None,
        faults={}, follows=None, provenance={}, operator=None, note=None, voided=None, created_at=NOW,
        started_at=NOW, finished_at=NOW, error=None, limit=limit,
    )  # fmt: skip
    return made.model_copy(update={"result": RESULT if status == "completed" else None, **more})


POOR, PLAIN, UNDECIDED = run("p", "failed"), run("d"), run("u", bias_limit_deg=1.0)
FOLLOWS_NOTHING = RESULT.model_copy(update={"rms_calibrated_deg": None})
FAILING = UNDECIDED.model_copy(update={"id": "p", "result": FOLLOWS_NOTHING})
NOTHING = Progress(poses_done=0, poses_total=8, fraction=0.0, remaining_s=None)


@pytest.mark.parametrize(
    ("one", "word"),
    [
        (UNDECIDED, "done"),
        (FAILING, "fail"),
        (PLAIN, "done"),
        (POOR, "fail"),
        (run("f", "failed", progress=NOTHING), None),
        (run("a", "aborted"), None),
        (run("i", "interrupted"), None),
    ],
)
def test_a_run_comes_to_one_word_or_to_nothing(one: Run, word: str | None) -> None:
    assert word_of(one) == word
    now = settled([Turn(0, "A", "running", "r", one.id), Turn(1, "B")], {one.id: one}, ["r"], "end")
    (first, *_) = now.turns
    assert first.state == ("waiting" if word is None else "failed" if word == "fail" else "done")
    on = now.on["r"]
    assert on is not None
    assert on.unit == ("A" if word is None else "B"), "where nothing came of it, the unit stays next"


def test_a_unit_that_fails_is_measured_once_more_at_the_end_and_not_again() -> None:
    turns = [Turn(0, "A", "running", "r", "p"), Turn(1, "B")]
    now = settled(turns, {"p": POOR}, ["r"], "end")
    assert [(turn.unit, turn.state) for turn in now.turns] == [
        ("A", "failed"),
        ("B", "waiting"),
        ("A", "waiting"),
    ]
    again = [now.turns[0], replace(now.turns[1], state="done"), Turn(2, "A", "running", "r", "p2")]
    now = settled(again, {"p": POOR, "p2": POOR.model_copy(update={"id": "p2"})}, ["r"], "end")
    assert [turn.state for turn in now.turns] == ["failed", "done", "failed"]
    assert now.on["r"] is None


def test_or_the_run_that_tells_why_comes_next_while_it_is_mounted() -> None:
    turns = [Turn(0, "A", "running", "r", "p"), Turn(1, "B", rig="r")]
    now = settled(turns, {"p": FAILING}, ["r"], "follow_up")
    on, then = now.on["r"], now.then["r"]
    assert on is not None and then is not None
    assert (on.unit, on.state, on.run_id, then.unit) == ("A", "follow_up", "p", "B")
    followed = [now.turns[0], now.turns[1], replace(now.turns[2], state="running", run_id="p2")]
    now = settled(
        followed,
        {"p": FAILING, "p2": FAILING.model_copy(update={"id": "p2", "follows": "p"})},
        ["r"],
        "follow_up",
    )
    assert [turn.state for turn in now.turns] == ["failed", "waiting", "failed"]


def test_rigs_side_by_side_keep_what_their_pages_show() -> None:
    turns = [Turn(0, "A", rig="l"), Turn(1, "B", "running", "r", "b"), Turn(2, "C"), Turn(3, "D", rig="r")]
    now = settled(turns, {"b": run("b", "running")}, ["l", "r"], "end")
    assert [(now.on[rig].unit, now.then[rig].unit) for rig in ("l", "r")] == [("A", "C"), ("B", "D")]  # type: ignore[union-attr]
    assert now.written == []


def test_a_rig_that_is_left_without_a_unit_takes_what_is_kept_for_one_that_has_another_before_it() -> None:
    turns = [Turn(0, "A", "running", "l", "a"), Turn(1, "B", "running", "r", "b"), Turn(2, "C", rig="l")]
    runs = {"a": run("a", "running"), "b": run("b", "running")}
    now = settled(turns, runs, ["l", "r"], "end")
    assert now.then["l"] == turns[2] and now.then["r"] is None
    now = settled(turns, {**runs, "b": run("b")}, ["l", "r"], "end")
    assert now.on["r"] == replace(turns[2], rig=None) and now.then["l"] is None
    taken = [*turns[:2], replace(turns[2], rig="r")]  # as the first look at it has written
    now = settled(taken, {"a": run("a"), "b": run("b")}, ["l", "r"], "end")
    assert (now.on["l"], now.on["r"]) == (None, taken[2]), "what a person has been shown stays where it is"


def test_what_is_mounted_on_a_rig_or_asked_for_there_goes_to_no_other_one() -> None:
    why = Turn(2, "A", "follow_up", "l", "p")
    for held in (Turn(1, "B", rig="l"), Turn(1, "B", rig="l", run_id="n", why="it was aborted"), why):
        now = settled([Turn(0, "A", "failed", "l", "p"), held], {}, ["l", "r"], "follow_up")
        assert (now.on["l"], now.on["r"]) == (held, None)


def test_a_list_is_finished_once_every_unit_has_had_all_its_turns() -> None:
    turns = [Turn(0, "A", "running", "r", "p"), Turn(1, "B", "removed")]
    assert not settled(turns, {"p": run("p", "running")}, ["r"], "end").is_finished
    assert not settled(turns, {"p": POOR}, ["r"], "end").is_finished, "it is measured once more"
    assert settled(turns, {"p": PLAIN}, ["r"], "end").is_finished
