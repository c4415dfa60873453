"""What a plan asks of a rig, before anything moves: its poses, and about how long they take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from calrig.analysis.errors import Invalid
from calrig.instruments.axis_goal import travel_time_s
from calrig.plan import Plan, PlanError, PlannedPose
from calrig.runs.good_enough import require_a_reference
from calrig.settings import RigSettings
from calrig.store import Store

ASSUMED_VELOCITY_DPS = 20.0
"""Of a stage that no run has asked yet; with the acceleration, an ordinary SMC100's."""
ASSUMED_ACCELERATION_DPS2 = 80.0
HOMING_AND_START_S = 5.0
"""Opening both ports and homing, which takes some stages longer and is left out by those referenced."""
FEW_ANGLES = 30
"""Of the dial: fewer do not tell the dozen orders that real axes have."""
QUESTIONS_S = 0.12
"""A pose's questions to stage and board, on simulated rigs of each kind."""


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
    """What a plan comes to on a rig, as fast as its stage was in the last run it completed.

    Raises:
        Invalid: an elevation lies beyond the rig's limits.
    """
    planned = planned_poses(plan, rig)
    require_a_reference(plan, rig, store)
    static = plan.kind == "static"
    velocity_dps, acceleration_dps2 = speed(rig, store)
    targets_deg = [0.0, *(pose.target_deg for pose in planned)]  # from about its home
    duration_s = (
        (HOMING_AND_START_S if planned else 0.0)
        + _travel_s(targets_deg, plan.velocity_dps or velocity_dps, acceleration_dps2)
        + (1 if static else len(planned)) * (plan.settle_s + plan.dwell_s + QUESTIONS_S)
        + (0 if static else plan.sweeps * len(plan.mounts_deg)) * plan.wait_s
    )
    elevations_deg = [pose.target_deg for pose in planned] if static else plan.elevations()
    return PlanEstimate(0 if static else len(planned), elevations_deg, duration_s)


def _travel_s(targets_deg: Sequence[float], velocity_dps: float, acceleration_dps2: float) -> float:
    ways_deg = (abs(after - before) for before, after in pairwise(targets_deg))
    return sum(travel_time_s(way_deg, velocity_dps, acceleration_dps2) for way_deg in ways_deg)


def speed(rig: RigSettings, store: Store | None) -> tuple[float, float]:
    """Velocity and acceleration of elevation, deg/s and deg/s²; assumed where there is no store yet."""
    latest = [] if store is None else store.runs(rig=rig.name, status="completed", limit=1)[0]
    said = latest[0].provenance.get("stage", {}) if latest else {}
    ratio = rig.stage.ratio if rig.stage else 1.0
    velocity_dps, acceleration_dps2 = said.get("velocity_dps"), said.get("acceleration_dps2")
    return (
        velocity_dps / ratio if velocity_dps else ASSUMED_VELOCITY_DPS,
        acceleration_dps2 / ratio if acceleration_dps2 else ASSUMED_ACCELERATION_DPS2,
    )
