"""What a plan asks of a rig, before anything moves: its poses, and about how long they take."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from calrig.analysis.errors import Invalid
from calrig.plan import Plan, PlanError, PlannedPose
from calrig.runs.rig_pace import rig_pace
from calrig.settings import RigSettings
from calrig.store import Store

FEW_ANGLES = 30
"""Of the dial: fewer do not tell the dozen orders that real axes have."""


@dataclass(frozen=True, slots=True)
class PlanEstimate:
    """What a plan comes to.

    Attributes:
        n_poses: poses to be measured; none of a static log.
        elevations_deg: of one sweep, neither ordered nor jittered.
        duration_s: about how long it takes by the board's clock, without a wait for a temperature or for a
            person who turns the unit; the most, where dwells end as soon as their standard error is reached.
    """

    n_poses: int
    elevations_deg: list[float]
    duration_s: float


def grid_says(plan: Plan) -> list[str]:
    """What a plan of several mounts on one grid of elevations leaves unseen; empty for any other."""
    if len(plan.mounts_deg) < 2 or plan.jitter_deg or len(set(plan.elevations())) > FEW_ANGLES:
        return []
    return [
        f"Every mount stands at the same {len(set(plan.elevations()))} angles of the dial: what the stage "
        "does between them shows in none. A jitter of half a step lets it show."
    ]


def planned_poses(plan: Plan, rig: RigSettings) -> list[PlannedPose]:
    """Every pose of a plan on a rig, in the order measured.

    Raises:
        Invalid: an elevation lies beyond the rig's limits.
    """
    try:
        return plan.poses(rig.limits_deg)
    except PlanError as error:
        raise Invalid(f"rig {rig.name!r}: {error}", _beyond(plan, rig.limits_deg)) from error


def _beyond(plan: Plan, limits_deg: tuple[float, float]) -> list[str]:
    """Which fields of a plan lie beyond a rig's limits."""
    low, high = limits_deg
    if plan.elevations_deg is None:
        ends = {"start_deg": plan.start_deg, "stop_deg": plan.stop_deg}
    else:
        ends = {f"elevations_deg[{k}]": one for k, one in enumerate(plan.elevations_deg)}
    return [f"plan.{name}" for name, elevation_deg in ends.items() if not low <= elevation_deg <= high]


def estimate(plan: Plan, rig: RigSettings, store: Store) -> PlanEstimate:
    """What a plan comes to on a rig, as fast as the last run was that the rig completed.

    Raises:
        Invalid: an elevation lies beyond the rig's limits.
    """
    planned = planned_poses(plan, rig)
    static = plan.kind == "static"
    pace = rig_pace(rig, store)
    dwells = [pose for pose in planned if pose.stretch_deg is None]
    swept = plan.kind == "sweep"  # which goes to its first end as fast as the stage can
    first_dps, turn_dps = (None, plan.turn_dps) if swept else (plan.velocity_dps, plan.velocity_dps)
    first_s = pace.begin_s + pace.way_s([planned[0].target_deg], first_dps) if planned else 0.0
    ways = pairwise([pose.target_deg for pose in dwells])
    duration_s = (
        first_s
        + sum(pace.travel_s(after - before, turn_dps) for before, after in ways)
        + (1 if static else len(dwells)) * (plan.settle_s + plan.dwell_s)
        + (1 if static else len(dwells)) * (pace.pass_s if swept else pace.questions_s)
        + (plan.first_settle_s - plan.settle_s)
        + (0 if static else plan.sweeps * len(plan.mounts_deg)) * plan.wait_s
    )
    elevations_deg = [pose.target_deg for pose in planned] if static else plan.elevations()
    return PlanEstimate(0 if static else len(planned), elevations_deg, duration_s)
