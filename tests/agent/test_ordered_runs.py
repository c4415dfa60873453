"""What an order tells a bench of other runs comes through JSON as the centre knows it."""

from __future__ import annotations

import json
import random

from support import QUICK

from calrig.analysis.calibration_in_force import ActiveCalibration
from calrig.analysis.stored_runs import AmbiguousRuns
from calrig.calibration.line import Line
from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.regression.request import AS_USUAL
from calrig.calibration.uncertainty.budget import ReferenceFigures
from calrig.plan import Plan
from calrig.runs.assignment import NewRun, order_part, ordered_run
from calrig.runs.follow_up import FollowUpRun
from calrig.settings import BoardSettings, RigSettings, StageSettings

RIG = RigSettings(
    name="bench-1", stage=StageSettings(driver="smc100", port=""), imu=BoardSettings(driver="calrig", port="")
)
RUN_ID = "00000000-0000-4000-8000-000000000001"


def ordered(plan: Plan, **part: object):
    """The run as the bench reads it."""
    wanted = NewRun(unit="AS-1", plan=plan, operator="mara", **part)
    document = {**wanted.columns(len(plan.elevations())), **order_part(wanted)}
    return ordered_run(RUN_ID, json.loads(json.dumps(document)), RIG)


def test_a_verification_applies_the_same_line_effects_and_reference() -> None:
    verifies = ActiveCalibration(
        revision=3,
        run_id="17",
        line=Line(0.8, 1.01, 0.001, 2e-5, ((1e-6, 0.0), (0.0, 4e-10)), None),
        effects=[("misalignment", {"tilt_deg": 0.1}), ("backlash", {"play_deg": 0.03})],
        reference=ReferenceFigures(std_deg=0.29, kind="harmonic", bias_std_deg=0.1, scale_std=None),
        of_rig=[("backlash", {"backlash_deg": 0.1})],
    )
    run = ordered(Plan.model_validate({**QUICK, "kind": "verification"}), verifies=verifies)
    assert run.verifies == verifies
    assert (run.run_id, run.unit, run.operator, run.follow_up) == (RUN_ID, "AS-1", "mara", None)


def test_a_follow_up_rests_on_the_same_poses_and_finds_the_same_in_them() -> None:
    rng = random.Random(3)
    poses = []
    for approach in (1, -1, 1, -1):
        for elevation_deg in range(-60 * approach, 61 * approach, 10 * approach):
            reading_deg = elevation_deg - approach * 0.03 + rng.gauss(0.0, 0.025)
            poses.append(
                Pose(
                    float(elevation_deg),
                    reading_deg,
                    approach=approach,
                    time_s=4.0 * len(poses),
                    filtering=Filtering(),
                )
            )
    earlier = AmbiguousRuns.of(["17"], [poses], AS_USUAL)
    plan = Plan.model_validate({**QUICK, "sweeps": 1})
    run = ordered(plan, follow_up=FollowUpRun(earlier, ["backlash", "settling"], 2, plan, RIG.limits_deg))
    assert run.follow_up is not None
    again = run.follow_up.earlier
    assert (again.run_ids, again.poses) == (earlier.run_ids, earlier.poses)
    assert str(again.findings.found) == str(earlier.findings.found)
    assert run.follow_up.provenance() == {
        "separates": ["backlash", "settling"],
        "deciding": 2,
        "decided_on": [],
        "decided_early": False,
    }


def test_a_persons_word_for_where_the_stage_stands_comes_through() -> None:
    assert ordered(Plan.model_validate(QUICK), stage_at_deg=12.5).stage_at_deg == 12.5
