"""Accepting from a diagnosis of several runs: a difference between two of them corrects nothing."""

from __future__ import annotations

from typing import Any

import pytest

from calrig.analysis.diagnoses import Acceptance
from calrig.analysis.errors import Conflict
from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.store import Run, Store

POSES = [Pose(x, 0.8 + x, approach=1) for x in (-60.0, -30.0, 0.0, 30.0, 60.0)]
CHANGED = {"from": "1", "to": "2"}


def offset(z_mg: float, changed: dict[str, str] | None) -> dict[str, Any]:
    """An effect of a diagnosis, as far as accepting it looks."""
    parameters = {"y_mg": {"value": 0.0, "std": 0.1}, "z_mg": {"value": z_mg, "std": 0.1}}
    return {
        "name": "accelerometer_offset",
        "verdict": "named",
        "origin": "sensor",
        "parameters": parameters,
        "changed": changed,
        "confusable_with": [],
        "remedy": "subtract the offsets",
    }


def diagnosed(store: Store, *effects: dict[str, Any]) -> Run:
    run = store.runs.create(
        unit="AS-1",
        rig="bench-1",
        plan=None,
        status="completed",
        provenance={},
        poses=POSES,
        result=build_result(POSES).to_dict(),
    )
    store.runs.update(run.id, diagnosis={"runs": ["1", run.id], "effects": list(effects)})
    return run


def test_a_difference_between_two_runs_is_not_accepted(store: Store) -> None:
    run = diagnosed(store, offset(6.0, CHANGED))
    with pytest.raises(Conflict, match="diagnose the latest alone"):
        Acceptance(store).accept(run.id, ["accelerometer_offset"])


def test_what_was_the_same_in_all_runs_is_accepted_beside_what_changed(store: Store) -> None:
    run = diagnosed(store, offset(6.0, CHANGED), offset(2.0, None), offset(5.0, CHANGED))
    accepted = Acceptance(store).accept(run.id, ["accelerometer_offset"])
    assert accepted.diagnosis is not None
    at = [effect.get("accepted_at") is not None for effect in accepted.diagnosis["effects"]]
    assert at == [False, True, False]
