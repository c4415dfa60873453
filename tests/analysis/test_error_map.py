"""The rig's error map over stored runs: solved with the units, once one of them was clamped anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from studies.joint.rig import Bench, Design, Stage, drawn_stage, drawn_unit

from calrig.analysis.error_map import MOST_RUNS, basis_of, poses_by_mounting, solved_map
from calrig.calibration.results.result import build_result
from calrig.calibration.separation.pose_table import MountedPoses
from calrig.store import Run, Store


def laid(store: Store, lot: MountedPoses, rig: str = "bench-1") -> Run:
    """A run of one clamping."""
    return store.runs.create(
        unit=lot.unit,
        rig=rig,
        plan={"mounts_deg": [lot.nominal_deg]},
        status="completed",
        provenance={},
        poses=lot.poses,
        result=build_result(lot.poses).to_dict(),
    )


@pytest.fixture
def bench() -> tuple[Stage, Sequence[MountedPoses]]:
    """A stage worth 0.29° and what is measured on it: of one unit three clampings, of another one."""
    rng = np.random.default_rng(15)
    stage = drawn_stage(rng, gap_deg=0.05)
    three = Design((0.0, 120.0, 240.0), n=52).visits(rng)
    once = replace(Design((0.0,), n=52).visits(rng)[0], unit=1)
    units = (drawn_unit(rng), drawn_unit(rng))
    return stage, Bench(units, stage, (*three, once)).measured(rng)


def _solved_map(store):
    basis = basis_of(store, "bench-1")
    return solved_map(poses_by_mounting(store, basis), basis)


def test_one_unit_that_was_clamped_anew_fixes_the_map_of_the_rig(store, bench):
    stage, (first, second, third, other) = bench
    for lot in (first, other):
        laid(store, lot)
    before = _solved_map(store)
    assert (before.stage_deg, before.units) == ([], 2)
    assert "clamped at 0°, 120°, 240°" in before.says
    laid(store, second)
    bumped = laid(store, first)
    store.amendments.void(bumped.id, "bumped")
    laid(store, third)
    found = _solved_map(store)
    assert (found.units, set(found.approach)) == (2, {-1, 1})
    dial, approach = np.array(found.stage_deg), np.array(found.approach)
    left = stage.table_deg(dial, approach) - dial - np.array(found.error_deg)
    left -= left.mean()
    assert np.sqrt(np.mean(left**2)) < 0.015, "of 0.29°"
    assert np.mean(np.abs(left) < 2.5 * np.array(found.std_deg)) > 0.9
    assert "the newest 4 runs" in found.says


def test_a_rig_without_runs_has_none_and_of_many_the_newest_count(store, bench):
    assert _solved_map(store).says == "Not known yet: the rig has no completed run."
    _, (first, second, _, _) = bench
    remounted = laid(store, second)
    runs = [laid(store, replace(first, poses=first.poses[:4])) for _ in range(MOST_RUNS + 1)]
    chosen = [run_id for run_id, _ in basis_of(store, "bench-1").runs]
    assert chosen == [remounted.id, *(run.id for run in runs[:1:-1])]
    store.amendments.exclude_pose(runs[-1].id, 1, "leant on", result=None)
    assert dict(basis_of(store, "bench-1").runs)[runs[-1].id] == 3
