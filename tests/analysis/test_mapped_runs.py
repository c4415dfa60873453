"""What a stored run makes of the map that it keeps, whatever is in force now."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from kept_maps import solved

from calrig.analysis.certificates import certificate
from calrig.analysis.results import fitted, refitted
from calrig.analysis.revisions import Issuer
from calrig.analysis.stage_maps import provenance_part, put_in_force
from calrig.calibration.poses import Pose
from calrig.laboratory import LaboratorySettings
from calrig.store import AcceptedEffect, Run, Store

DIAL_DEG = np.repeat(np.linspace(-60.0, 60.0, 7), 2)


@pytest.fixture
def run(store: Store) -> Run:
    """A run of a faultless unit by the map in force, which is the stage's own."""
    solution = store.solutions.save(solved())
    put_in_force(store, "bench-1", solution.id, who=None)
    kept = provenance_part(store, "bench-1", {})
    angle = np.radians(DIAL_DEG)
    elevation = DIAL_DEG + 0.05 * np.sin(angle) + 0.02 * np.cos(2 * angle) - 0.01 * np.sin(3 * angle)
    poses = [Pose(float(d), float(e)) for d, e in zip(DIAL_DEG, elevation, strict=True)]
    return laid(store, poses, {**kept, "rig": {"reference": {"std_deg": 0.29}}})


def laid(store: Store, poses: list[Pose], provenance: dict[str, Any]) -> Run:
    given: dict[str, Any] = {"plan": None, "status": "completed", "provenance": provenance}
    return store.runs.create(unit="A", rig="bench-1", poses=poses, **given)


def counted(store: Store, run: Run) -> list[Pose]:
    return [one.pose for one in store.poses.of(run.id, include_excluded=False)]


def test_a_run_rests_on_its_own_map_when_none_is_in_force_any_more(store, run):
    store.stage_maps.withdraw("bench-1", "the gear was changed")
    result = refitted(store, run, counted(store, run))
    assert result.scale == pytest.approx(1.0, abs=1e-9)
    assert result.rms_calibrated_deg < 1e-9 < 0.01 < result.rms_raw_deg
    assert result.reference.kind == "map"
    (batch,) = store.poses.batches_of(run.id)
    assert [one.pose.map_deg for one in batch] == [pose.map_deg for pose in counted(store, run)]


def test_what_was_accepted_of_the_stage_is_in_its_map_already(store, run):
    parameters = {"amplitude_deg": 0.05, "phase_deg": 0.0}
    of_rig = AcceptedEffect(run.id, None, "bench-1", "stage_eccentricity", "stage", parameters)
    poses = counted(store, run)
    assert fitted(poses, [of_rig], run.provenance) == fitted(poses, [], run.provenance)


def test_a_pose_beyond_the_map_leaves_the_run_to_the_certificate_until_it_is_excluded(store, run):
    far = laid(store, [*counted(store, run), Pose(80.0, 80.0)], run.provenance)
    result = refitted(store, far, counted(store, far))
    assert (result.reference.kind, result.reference.std_deg) == ("harmonic", 0.29)
    assert "80° to 80°" in result.reference_says
    store.amendments.exclude_pose(far.id, 14, "beyond the map", result=None)
    again = refitted(store, far, counted(store, far))
    assert again.reference.kind == "map"
    assert again.reference_says is None


def test_a_certificate_states_the_map_with_what_it_rests_on(store, run):
    poses = [Pose(float(d), float(d) + 0.01 * (-1) ** k) for k, d in enumerate(DIAL_DEG)]
    noisy = laid(store, poses, run.provenance)
    store.runs.update(noisy.id, result=fitted(counted(store, noisy), [], noisy.provenance).to_dict())
    said = certificate(store, Issuer(store).draft("A", noisy.id), LaboratorySettings())
    of_stage = next(line for line in said.budget.contributions if line.type_ == "B")
    assert "by its map" in of_stage.title
    assert of_stage.distribution == "normal"
    assert said.budget.combined_deg * said.budget.coverage_factor == pytest.approx(said.budget.expanded_deg)
    assert sum(line.share for line in said.budget.contributions) == pytest.approx(1.0)
    assert said.standards[0].sha256 == run.provenance["stage_map"]["sha256"]
    assert "the stage's map" in said.traceable
