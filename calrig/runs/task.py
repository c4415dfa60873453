"""What a worker is given: one run, to be carried out from its beginning or from where it was left."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from calrig.analysis.active_calibration import ActiveCalibration
from calrig.calibration.poses import Pose
from calrig.estimation.gyro import GyroBias
from calrig.plan import Plan, PlannedPose
from calrig.runs.follow_up import FollowUpRun
from calrig.settings import RigSettings
from calrig.store import Run


@dataclass(frozen=True, slots=True)
class Earlier:
    """What a run measured before it was interrupted; empty of one that begins.

    Attributes:
        poses: all, in order.
        biases: of the gyro, from each pose's dwell whose samples are still there.
        logged_s: of a static log, how much of it there is.
        clock_s: where the run's time goes on, s since it began.
        faults: counts by kind.
    """

    poses: list[Pose] = field(default_factory=list)
    biases: list[GyroBias] = field(default_factory=list)
    logged_s: float = 0.0
    clock_s: float = 0.0
    faults: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Task:
    """A run with its rig, its plan, and what it needs to know of other runs.

    Attributes:
        run: as it was stored last.
        planned: every pose of the plan.
        follow_up: of a run that follows others.
        verifies: of a verification.
        earlier: what was measured before an interruption.
        interruption: what the run's provenance is to say of it; None where there was none.
        stage_at_deg: a person's word for the elevation at which a stage without homing stands.
    """

    run: Run
    rig: RigSettings
    plan: Plan
    planned: list[PlannedPose]
    follow_up: FollowUpRun | None = None
    verifies: ActiveCalibration | None = None
    earlier: Earlier = field(default_factory=Earlier)
    interruption: dict[str, Any] | None = None
    stage_at_deg: float | None = None
