"""Stored runs of a unit clamped by its faces: what their samples say of the gyro's axes."""

from __future__ import annotations

import numpy as np
import pytest
from postgresql_server import store_at

from calrig.analysis.solutions import poses_with_gyro
from calrig.calibration.poses import Pose
from calrig.store import Store
from calrig.store.records import SampleBlock

RATE_HZ = 100.0
BIAS_DPS = np.array([1.0, -0.5, 0.25])
AXIS = np.array([0.02, 0.9996, -0.01])


def block(index, phase, first_s, lasts_s, rate_dps):
    n = round(lasts_s * RATE_HZ)
    time_s = first_s + np.arange(n) / RATE_HZ
    gyro = np.tile(BIAS_DPS + rate_dps * AXIS, (n, 1))
    return SampleBlock(index, phase, time_s, np.zeros((n, 3)), gyro, np.full(n, 25.0))


@pytest.fixture
def store(tmp_path):
    with Store.open(store_at(tmp_path / "calrig.db"), writer="tests") as opened:
        yield opened


@pytest.fixture
def run_id(store):
    """Three poses: a full turn to the second at 60 °/s, one back to the third; each dwell 1 s."""
    run = store.runs.create(unit="AS-1", rig="bench-1", plan=None, status="running", provenance={})
    for index, rate_dps in enumerate((0.0, 60.0, -60.0)):
        first_s = 7.0 * index
        blocks = [block(index, "move", first_s - 6.0, 6.0, rate_dps)] if index else []
        blocks.append(block(index, "dwell", first_s, 1.0, 0.0))
        pose = Pose(360.0 * (index % 2), 0.0)
        store.poses.add(run.id, index, pose, blocks, [("pose", {"index": index})])
    return run.id


def test_each_move_is_integrated_about_three_axes(store, run_id):
    first, up, down = poses_with_gyro(store, run_id)
    turned = [[pose.covariates.get(f"gyro_move_{axis}_deg") for axis in "xyz"] for pose in (first, up, down)]
    assert turned[0] == [None] * 3
    assert turned[1] == pytest.approx(360.0 * AXIS, abs=0.7)
    assert turned[2] == pytest.approx(-360.0 * AXIS, abs=0.7)
    means = [first.covariates[f"gyro_{axis}_dps"] for axis in "xyz"]
    assert means == pytest.approx(BIAS_DPS)
    told_s = [pose.covariates["host_time_s"] for pose in (first, up, down)]
    assert told_s == sorted(told_s)


def test_a_move_from_a_pose_that_was_excluded_is_not_told(store, run_id):
    store.amendments.exclude_pose(run_id, 1, "touched", result=None)
    first, down = poses_with_gyro(store, run_id)
    assert "gyro_x_dps" in first.covariates
    assert "gyro_move_x_deg" not in down.covariates
