"""The loop closed on the rig: what one run leaves ambiguous, the next one, designed for it, decides."""

from __future__ import annotations

import random

import pytest
from run_rigs import TruthRig, diagnosed
from support import running_service

from calrig.analysis.errors import Conflict
from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.plan import Plan

ONE_SWEEP = Plan(sweeps=1, settle_s=0.5, dwell_s=0.5)


def completed(service, run):
    ended = service.wait(run.id, 60.0)
    assert ended.status == "completed", ended.error
    return ended


PLAY_DEG = 0.06


def measured_without_witnesses() -> list[Pose]:
    """Readings alone of a stage with play, on an exact grid: moves not yet settled would look the same."""
    rng = random.Random(3)
    poses = []
    for sweep in range(4):
        approach = 1 if sweep % 2 == 0 else -1
        for elevation in range(-60 * approach, 61 * approach, 10 * approach):
            reading = elevation - approach * PLAY_DEG / 2 + rng.gauss(0.0, 0.025)
            poses.append(Pose(elevation, reading, sweep=sweep, approach=approach, time_s=4.0 * len(poses)))
    return poses


def test_a_follow_up_decides_between_the_suspects_and_confirms_on_poses_of_its_own(tmp_path):
    rig = TruthRig("playing-rig", seed=5, mechanics={"backlash_deg": PLAY_DEG})
    with rig.simulated, running_service(tmp_path / "calrig.db", rig.settings) as service:
        poses = measured_without_witnesses()
        first = service.store.runs.create(
            unit="AS-1",
            rig="playing-rig",
            plan=Plan(settle_s=0.5, dwell_s=0.5).model_dump(mode="json"),
            status="completed",
            provenance={"rig": {"limits_deg": [-90.0, 90.0]}},
            poses=poses,
            result=build_result(poses).to_dict(),
        )
        before = diagnosed(service.store, first.id)
        assert before["verdict"] == "ambiguous"
        (effect,) = before["effects"]
        assert {effect["name"], *effect["confusable_with"]} == {"backlash", "settling"}
        assert before["follow_up"]["separation"] > 12.0

        asked = service.follow_up_question(first.id)
        second = completed(service, service.follow_up(asked, asked.work()))

        after = second.diagnosis
        assert second.follows == first.id
        assert after["runs"] == [first.id, second.id]
        assert second.progress.poses_done < len(before["follow_up"]["plan"]["elevations_deg"])
        effect, moved = after["effects"]
        assert (effect["name"], effect["verdict"], effect["changed"]) == ("backlash", "named", None)
        # the rig's mount lies at 0.8°, that of the poses before it at 0°
        assert moved["changed"] == {"from": first.id, "to": second.id}
        assert abs(moved["parameters"]["deg"]["value"] - 0.8) < 0.1
        found = effect["parameters"]["backlash_deg"]
        assert abs(found["value"] + PLAY_DEG) < 3 * found["std"]
        assert after["confirmed_by"]["run_id"] == second.id
        assert after["confirmed_by"]["after_rms_deg"] < after["confirmed_by"]["before_rms_deg"]


def test_a_run_that_leaves_nothing_ambiguous_has_no_follow_up(service):
    run = completed(service, service.start(unit="AS-1", plan=ONE_SWEEP))
    asked = service.follow_up_question(run.id)
    with pytest.raises(Conflict, match="nothing is left to separate"):
        service.follow_up(asked, asked.work())
    assert service.store.runs.page()[0][0].id == run.id


def test_a_diagnosis_takes_only_runs_of_one_unit_that_have_ended(service):
    one, other = (completed(service, service.start(unit=unit, plan=ONE_SWEEP)) for unit in ("AS-1", "AS-2"))
    with pytest.raises(Conflict, match=rf"run {one.id} is of unit 'AS-1', run {other.id} of unit 'AS-2'"):
        diagnosed(service.store, other.id, one.id)
