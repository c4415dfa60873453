"""All runs at once: their poses in pieces are those of each run alone, and findings are kept by run."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing

import numpy as np
import pytest

from calrig.calibration.packed_poses import packed
from calrig.calibration.poses import GYRO_MEANS, Pose
from calrig.store import Run, Store, StoreDamagedError, fleet
from calrig.store.fleet import Finding

NewRun = Callable[..., Run]


def poses(n: int, seed: int = 0) -> list[Pose]:
    rng = np.random.default_rng(seed)
    return [
        Pose(
            target_deg=5.0 * k,
            reading_deg=5.0 * k + float(rng.normal()),
            sweep=0,
            approach=1 if k % 2 else None,
            temperature_c=None if k == 1 else -0.0,
            n_samples=400,
            covariates={
                **({"humidity": float(rng.normal()), "lamp": None} if seed == 2 else {}),
                **({name: float(rng.normal()) for name in GYRO_MEANS} if seed in (1, 2) else {}),
            },
        )
        for k in range(n)
    ]


def completed(new_run: NewRun, n: int = 12, seed: int = 0, **given: object) -> Run:
    return new_run(status="completed", poses=poses(n, seed), **given)


def listed(store: Store) -> list[fleet.ListedRun]:
    return [run for part in store.fleet.completed_runs() for run in part]


def test_completed_runs_that_count_are_listed_with_what_was_found_in_them(store, new_run):
    plain, found, voided = (completed(new_run, unit=unit) for unit in "ABC")
    new_run(poses=poses(3))
    new_run(status="completed", plan={"kind": "static"})
    store.runs.update(found.id, diagnosis={"verdict": "named", "effects": []})
    store.amendments.void(voided.id, "bumped")
    runs = listed(store)
    assert [(run.id, run.unit, run.rig, run.verdict, run.n_poses) for run in runs] == [
        (plain.id, "A", "bench", None, 12),
        (found.id, "B", "bench", "named", 12),
    ]


@pytest.mark.parametrize(
    ("at_once", "with_gyro"), [(1, False), (25, True), (100_000, False), (100_000, True)]
)
def test_packed_poses_are_those_of_each_run_by_itself(store, new_run, monkeypatch, at_once, with_gyro):
    monkeypatch.setattr(fleet, "POSES_AT_ONCE", at_once)
    monkeypatch.setattr(fleet, "ROWS_AT_ONCE", 7)
    monkeypatch.setattr(fleet, "RUNS_AT_ONCE", 2)
    runs = [completed(new_run, n, seed) for seed, n in enumerate([12, 9, 30, 1])]
    new_run(poses=poses(5))  # goes on, among the others
    runs.append(completed(new_run, 8, 7))
    store.amendments.exclude_pose(runs[1].id, 4, "bumped", result=None)
    pieces = list(store.fleet.packed_poses(listed(store), with_gyro=with_gyro))
    left_out = set() if with_gyro else set(GYRO_MEANS)
    assert [run for piece in pieces for run in piece.run_ids] == [run.id for run in runs]
    assert len(pieces) > 1 or at_once > 60
    for piece in pieces:
        for k, run_id in enumerate(piece.run_ids):
            counted = [stored.pose for stored in store.poses.of(run_id, include_excluded=False)]
            expected = packed({run_id: counted}).columns
            found = piece.runs(np.array([k])).columns
            assert not left_out & set(found)
            for name in {*expected, *found} - left_out:
                column = expected.get(name, np.full(len(counted), np.nan))
                np.testing.assert_array_equal(found.get(name, np.full(len(counted), np.nan)), column, name)


def test_a_pose_that_changed_or_is_missing_is_said(store, new_run, database):
    run = completed(new_run)
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE pose SET reading_deg = reading_deg + 1e-9 WHERE pose_index = 7")
    with pytest.raises(StoreDamagedError, match=f"pose 7 of run {run.id} is not what was stored"):
        list(store.fleet.packed_poses(listed(store)))
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("DELETE FROM pose WHERE pose_index = 7")
    with pytest.raises(StoreDamagedError, match=f"1 poses of run {run.id} are missing"):
        list(store.fleet.packed_poses(listed(store)))


def test_the_last_finding_of_a_run_is_kept(store):
    store.findings.save("x", "0" * 64, "a" * 64, None, "too few poses")
    assert store.findings.all() == {"x": Finding("0" * 64, "a" * 64, None)}
    store.findings.save("x", "1" * 64, "b" * 64, {"verdict": "named", "effects": []})
    assert store.findings.all() == {"x": Finding("1" * 64, "b" * 64, "named")}
    assert store.findings.document("x") == {"verdict": "named", "effects": []}
    assert store.findings.document("y") is None
