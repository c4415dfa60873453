"""The rig error map over stored runs: which run of a unit counts, and which unit."""

from __future__ import annotations

import pytest

from calrig.analysis.error_map import error_map
from calrig.calibration.pose import Pose
from calrig.calibration.result import build_result
from calrig.store import Run, Store

STAGE_DEG = [-60.0, -30.0, 0.0, 30.0, 60.0]
STAGES_OWN_DEG = [0.02, -0.04, 0.04, -0.04, 0.02]
"""Of the stage at each elevation: no part of it looks like bias or scale."""
WORN_DEG = [-0.03, 0.06, -0.06, 0.06, -0.03]
"""What the stage had before it was repaired."""


def calibrated(store: Store, unit: str, of_stage_deg: list[float], rig: str = "bench-1") -> Run:
    """A calibration of a unit whose readings have the stage's error."""
    poses = [Pose(x, 0.8 + x + e, approach=1) for x, e in zip(STAGE_DEG, of_stage_deg, strict=True)]
    return store.create_run(
        unit=unit,
        rig=rig,
        plan=None,
        status="completed",
        provenance={},
        poses=poses,
        result=build_result(poses).to_dict(),
    )


def test_the_map_is_that_of_each_units_newest_calibration_on_the_rig(store: Store) -> None:
    for unit in ("A", "B", "C"):
        calibrated(store, unit, WORN_DEG)
    for unit in ("C", "A", "B"):
        calibrated(store, unit, STAGES_OWN_DEG)
        calibrated(store, unit, WORN_DEG, rig="bench-2")
    found = error_map(store, "bench-1")
    assert (found.units, found.stage_deg, found.approach) == (3, STAGE_DEG, [1] * 5)
    assert found.error_deg == pytest.approx(STAGES_OWN_DEG, abs=1e-9)
    assert found.std_deg == pytest.approx([0.0] * 5, abs=1e-9)


def test_a_run_that_was_voided_leaves_the_one_before_it(store: Store) -> None:
    for unit in ("A", "B", "C"):
        calibrated(store, unit, STAGES_OWN_DEG)
        store.void_run(calibrated(store, unit, WORN_DEG).id, "bumped")
    assert error_map(store, "bench-1").error_deg == pytest.approx(STAGES_OWN_DEG, abs=1e-9)
