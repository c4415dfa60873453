"""A fleet read once more: who is diagnosed, what is told, and that nothing is done twice."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shared_processes import shared_workers

from calrig.analysis import fleet
from calrig.analysis.fleet import Workers, reanalyse
from calrig.calibration.poses import Pose
from calrig.calibration.results.pose_errors import residuals
from calrig.calibration.results.result import build_result
from calrig.errors import WorkError
from calrig.export.poses_parquet import write_poses
from calrig.store import Run, Store

THETA_DEG = np.tile(np.concatenate([np.linspace(-60, 60, 13), np.linspace(60, -60, 13)]), 2)
APPROACH = np.tile(np.repeat([1, -1], 13), 2)


def calibrated(
    store: Store, unit: str, seed: int, backlash_deg: float = 0.0, rig: str = "bench-1", n: int = 52
) -> Run:
    rng = np.random.default_rng(seed)
    reading = 0.8 + THETA_DEG + backlash_deg / 2.0 * APPROACH + rng.normal(0.0, 0.03, len(THETA_DEG))
    poses = [
        Pose(float(t), float(r), approach=int(a), time_s=5.0 * k)
        for k, (t, r, a) in enumerate(zip(THETA_DEG[:n], reading, APPROACH, strict=False))
    ]
    result = build_result(poses).to_dict()
    given: dict[str, Any] = {"plan": None, "status": "completed", "provenance": {}}
    return store.runs.create(unit=unit, rig=rig, poses=poses, result=result, **given)


@contextmanager
def unseen(_what: str) -> Iterator[Callable[[float], None]]:
    yield lambda share: None


@contextmanager
def nobody() -> Iterator[Workers]:
    pytest.fail("nothing is left to be diagnosed")
    yield


@pytest.fixture
def runs(store: Store) -> dict[str, Run]:
    """A backlash nobody has seen, noise, noise that was once taken for something, too few poses."""
    made = {
        "backlash": calibrated(store, "A", 1, backlash_deg=0.2),
        "noise": calibrated(store, "B", 2),
        "mistaken": calibrated(store, "C", 3),
        "short": calibrated(store, "D", 4, n=5),
    }
    store.runs.update(made["mistaken"].id, diagnosis={"verdict": "named", "effects": []})
    return made


def test_what_stands_out_or_had_a_name_is_diagnosed_once_more(store, runs):
    found = reanalyse(store, store, shared_workers, unseen)
    assert set(found) == {"runs", "changed", "failed", "rigs", "duration_s"}
    assert found["failed"] == []
    assert found["runs"] == 4
    assert found["changed"] == [
        {"run_id": runs["backlash"].id, "verdict_before": None, "verdict_now": "named"},
        {"run_id": runs["mistaken"].id, "verdict_before": "named", "verdict_now": "nothing"},
    ]
    assert set(store.findings.all()) == {runs["backlash"].id, runs["mistaken"].id}
    assert store.findings.document(runs["backlash"].id)["effects"][0]["name"] == "backlash"
    assert store.runs.get(runs["mistaken"].id).diagnosis["verdict"] == "named"  # what people saw stays


def test_nothing_is_done_twice_until_poses_or_catalogue_change(store, runs, monkeypatch):
    first = reanalyse(store, store, shared_workers, unseen)
    assert reanalyse(store, store, nobody, unseen)["changed"] == first["changed"]
    before = store.findings.all()
    store.amendments.exclude_pose(runs["mistaken"].id, 3, "bumped", result=None)
    reanalyse(store, store, shared_workers, unseen)
    after = store.findings.all()
    assert [run for run in after if after[run] != before[run]] == [runs["mistaken"].id]
    monkeypatch.setattr(fleet, "catalogue_version", lambda: "f" * 64)
    with pytest.raises(WorkError, match="another calrig"):  # the processes still have that of the files
        reanalyse(store, store, shared_workers, unseen)


def test_findings_can_go_elsewhere_and_the_screen_read_parquet(store, runs, tmp_path: Path):
    listed = [run for part in store.fleet.completed_runs() for run in part]
    write_poses(tmp_path / "poses", store.fleet.packed_poses(listed))
    store.amendments.void(runs["noise"].id, "bumped")  # the files have it still
    calibrated(store, "E", 5)  # and lack this one
    with Store.open(f"sqlite:///{tmp_path / 'found.db'}", writer="tests") as results:
        found = reanalyse(store, results, shared_workers, unseen, tmp_path / "poses")
        assert set(results.findings.all()) == {runs["backlash"].id, runs["mistaken"].id}
    assert store.findings.all() == {}
    direct = reanalyse(store, store, shared_workers, unseen)
    assert (found["runs"], found["changed"], found["rigs"]) == (4, direct["changed"], direct["rigs"])


def damage(store: Store, run: Run, what: str) -> None:
    """Spoils the third pose of a run in the store's file."""
    with store._database.writing() as session:
        session.connection().exec_driver_sql(
            f"UPDATE pose SET {what} WHERE pose_index = 2 "
            f"AND run_id = (SELECT id FROM run WHERE uid = '{run.id}')"
        )


@pytest.mark.parametrize("what", ["reading_deg = reading_deg + 1", "reading_deg = 'NaN'"])
def test_a_run_that_cannot_be_read_is_a_line_of_the_report(store, runs, what):
    whole = reanalyse(store, store, shared_workers, unseen)
    damage(store, runs["noise"], what)
    damage(store, runs["mistaken"], what)
    found = reanalyse(store, store, shared_workers, unseen)
    assert {one["run_id"] for one in found["failed"]} == {runs["noise"].id, runs["mistaken"].id}
    assert all("damaged" in one["error"] and "\n" not in one["error"] for one in found["failed"])
    assert (found["runs"], found["changed"]) == (4, whole["changed"][:1])


def test_a_diagnosis_whose_process_dies_is_a_line_and_is_made_the_next_time(store, runs):
    def kill_first() -> AbstractContextManager[Workers]:
        with shared_workers() as real:
            deaths = iter([partial(signal.raise_signal, signal.SIGKILL)])
            return nullcontext(replace(real, submit=lambda asked: real.submit(next(deaths, asked))))

    first = reanalyse(store, store, kill_first, unseen)
    (failed,) = first["failed"]
    assert failed["run_id"] == runs["backlash"].id
    assert "its process ended (status -9)" in failed["error"]
    assert [one["run_id"] for one in first["changed"]] == [runs["mistaken"].id]
    again = reanalyse(store, store, shared_workers, unseen)
    assert again["failed"] == []
    assert [one["run_id"] for one in again["changed"]] == [runs["backlash"].id, runs["mistaken"].id]


def test_the_map_of_a_rig_is_the_mean_of_its_units_over_all_their_runs(store):
    made = [calibrated(store, unit, seed, backlash_deg=0.1) for seed, unit in enumerate("ABC")]

    def left_at(run, theta_deg, approach):
        poses = [one.pose for one in store.poses.of(run.id)]
        left = residuals(poses, run.result.bias_deg, run.result.scale)
        here = [(pose.theta_deg, pose.approach) == (theta_deg, approach) for pose in poses]
        return np.mean(np.array(left)[here])

    (found,) = reanalyse(store, store, shared_workers, unseen)["rigs"]
    assert (found["rig"], found["units"]) == ("bench-1", 3)
    places = sorted(set(zip(THETA_DEG.tolist(), APPROACH.tolist(), strict=True)))
    assert list(zip(found["map"]["stage_deg"], found["map"]["approach"], strict=True)) == places
    means = np.array([[left_at(run, *place) for place in places] for run in made])
    assert found["map"]["error_deg"] == pytest.approx(means.mean(axis=0), abs=1e-9)
    assert found["map"]["std_deg"] == pytest.approx(means.std(axis=0, ddof=1) / np.sqrt(3), abs=1e-9)
    for unit in "ABC":
        calibrated(store, unit, 9, backlash_deg=0.3)  # as many runs again, of one noise
    calibrated(store, "D", 4, rig="bench-2")
    both, alone = reanalyse(store, store, shared_workers, unseen)["rigs"]
    senses = np.array(both["map"]["approach"])
    errors = np.array(both["map"]["error_deg"])
    assert errors[senses > 0].mean() - errors[senses < 0].mean() == pytest.approx(0.2, abs=0.01)
    assert (alone["rig"], alone["units"], alone["map"]["error_deg"]) == ("bench-2", 1, [])
