"""Estimate what a plan takes and reaches: its poses, its time, and the goal of `until` (CONTRACT section 9).

Settling and dwelling are counted on the board's clock. The stage reports its velocity; the communication
time is that of the rig's last run. The reference uncertainty limits what sequential stopping can reach.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean, median

import numpy as np

from calrig.analysis.errors import Invalid
from calrig.analysis.results import fitted
from calrig.calibration.plan_design import Goals, TypeB
from calrig.calibration.poses import Pose
from calrig.calibration.results import FittedResult
from calrig.calibration.separation import StageMap, map_reference, with_map
from calrig.calibration.uncertainty import Ending, has_the_line, turned_both_ways
from calrig.instruments.axis import travel_time_s
from calrig.model.plan import Plan, PlanError, PlannedPose, Until
from calrig.model.result import Reference
from calrig.settings import RigSettings
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.records import Document, map_of

ASSUMED_VELOCITY_DPS = 20.0
"""Of a stage that no run has asked yet; with the acceleration, an ordinary SMC100's."""
ASSUMED_ACCELERATION_DPS2 = 80.0
HOMING_S = 4.0
"""Homing, where no run tells whether the stage homes and from where."""
START_S = 1.0
"""Opening both ports and identifying the devices, by the wall clock."""
HOMING_SHARE = 0.5
"""Of its velocity, at which an ordinary stage looks for its reference."""
QUESTIONS_S = 0.15
"""Communication time of a pose by the wall clock: 0.12 s of exchanges with stage and board, as on simulated
rigs of each kind, and 0.03 s to compute and store it. A simulated board counts `time_scale` times as much."""
RUNS_LOOKED_AT = 10
FEWEST_GAPS, FEWEST_PASSES = 4, 1
TRIMMED = 0.1
"""Share of the gaps at either end that does not count: a pause, or a machine that was busy elsewhere."""


@dataclass(frozen=True, slots=True)
class RigTiming:
    """What a rig takes.

    Attributes:
        velocity_dps, acceleration_dps2: of elevation.
        questions_s: a pose, beside move, settling and dwell.
        pass_s: a pass of a sweep, beside the turn and the dwell at its end.
        begin_s: from the start of a run to its first move.
        stands_deg: elevation from which the first move begins.
    """

    velocity_dps: float = ASSUMED_VELOCITY_DPS
    acceleration_dps2: float = ASSUMED_ACCELERATION_DPS2
    questions_s: float = QUESTIONS_S
    begin_s: float = START_S + HOMING_S
    stands_deg: float = 0.0
    pass_s: float = QUESTIONS_S

    def travel_s(self, way_deg: float, velocity_dps: float | None = None) -> float:
        """Time of a move, at the velocity that a plan asks for."""
        return travel_time_s(abs(way_deg), velocity_dps or self.velocity_dps, self.acceleration_dps2)

    def way_s(self, elevations_deg: Sequence[float], velocity_dps: float | None = None) -> float:
        """Time of the moves to one elevation after the other, the first from where the stage stands."""
        ways = pairwise((self.stands_deg, *elevations_deg))
        return sum(self.travel_s(after - before, velocity_dps) for before, after in ways)


def rig_pace(rig: RigSettings, store: Store | None) -> RigTiming:
    """As the last run that a rig completed shows it; assumed where there is none."""
    runs = [] if store is None else store.runs.page(rig=rig.name, status="completed", limit=RUNS_LOOKED_AT)[0]
    start_s, assumed_s = START_S * rig.time_scale, QUESTIONS_S * rig.time_scale
    if store is None or not runs:
        return RigTiming(questions_s=assumed_s, begin_s=start_s + HOMING_S, pass_s=assumed_s)
    velocity_dps, acceleration_dps2 = _speed(runs[0], rig)
    stopping = (_beside_s(run, _poses(store, run), _speed(run, rig)) for run in runs if run.kind != "sweep")
    turning = (_beside_s(run, _poses(store, run), _speed(run, rig)) for run in runs if run.kind == "sweep")
    questions_s = next((one for one in stopping if one is not None), assumed_s)
    pass_s = next((one for one in turning if one is not None), questions_s)
    stands_deg = next((poses[-1].target_deg for run in runs if (poses := _poses(store, run))), None)
    if stands_deg is None:
        return RigTiming(velocity_dps, acceleration_dps2, questions_s, start_s + HOMING_S, pass_s=pass_s)
    homes = runs[0].provenance.get("stage", {}).get("homes_each_time", False)
    begin_s = start_s + (abs(stands_deg) / (HOMING_SHARE * velocity_dps) if homes else 0.0)
    begins_deg = 0.0 if homes else stands_deg
    return RigTiming(velocity_dps, acceleration_dps2, questions_s, begin_s, begins_deg, pass_s)


def _poses(store: Store, run: Run) -> list[Pose]:
    return [stored.pose for stored in store.poses.of(run.id)]


def _speed(run: Run, rig: RigSettings) -> tuple[float, float]:
    """Velocity and acceleration of elevation, deg/s and deg/s², as the stage said in a run."""
    said = run.provenance.get("stage", {})
    ratio = rig.stage.ratio if rig.stage else 1.0
    velocity_dps, acceleration_dps2 = said.get("velocity_dps"), said.get("acceleration_dps2")
    return (
        velocity_dps / ratio if velocity_dps else ASSUMED_VELOCITY_DPS,
        acceleration_dps2 / ratio if acceleration_dps2 else ASSUMED_ACCELERATION_DPS2,
    )


def _tells(run: Run) -> bool:
    """Whether a run's dwells were as long as its plan says, and nothing came between them."""
    plan = run.plan or {}
    return (
        plan.get("kind") in ("calibration", "verification", "sweep")
        and not plan.get("target_std_deg")
        and not run.provenance.get("interruptions")
    )


def _beside_s(run: Run, poses: Sequence[Pose], speed: tuple[float, float]) -> float | None:
    """What lies between two dwells beside move, settling and dwell; None where nothing, or too little, tells.

    Of a sweep the first pass does not count, in which the program gets ready. `speed` is in elevation.
    """
    gaps_s = _gaps_s(run, poses, speed)
    return None if gaps_s is None else max(0.0, _trimmed_mean(gaps_s))


def paused_s(run: Run, poses: Sequence[Pose], rig: RigSettings) -> float:
    """Pauses by the board's clock: what lay between the dwells of a completed run beyond the usual."""
    gaps_s = _gaps_s(run, poses, _speed(run, rig))
    return 0.0 if gaps_s is None else max(0.0, sum(gaps_s) - len(gaps_s) * _trimmed_mean(gaps_s))


def _trimmed_mean(sorted_s: Sequence[float]) -> float:
    trimmed = int(TRIMMED * len(sorted_s))
    return fmean(sorted_s[trimmed : len(sorted_s) - trimmed])


def _gaps_s(run: Run, poses: Sequence[Pose], speed: tuple[float, float]) -> list[float] | None:
    """Time between one dwell and the next beside move, settling and dwell, ascending; arguments as above."""
    if not _tells(run):
        return None
    plan, pace, turns = Plan.model_validate(run.plan), RigTiming(*speed), run.kind == "sweep"
    velocity_dps = plan.turn_dps if turns else plan.velocity_dps
    dwells = [pose for pose in poses if pose.settle_s is not None][1:] if turns else poses
    gaps_s = sorted(
        after.time_s
        - before.time_s
        - plan.settle_s
        - plan.dwell_s
        - pace.travel_s(after.target_deg - before.target_deg, velocity_dps)
        for before, after in pairwise(dwells)
        if after.time_s is not None
        and before.time_s is not None
        and (before.sweep == after.sweep or (turns and not plan.wait_s))
    )
    return gaps_s if len(gaps_s) >= (FEWEST_PASSES if turns else FEWEST_GAPS) else None


SEATS_SAY = (
    "In each mount, the unit's x axis must lie along the stage's axis to 0.5°: `accel_x` is not used. If "
    "seats are askew by 2°, two stated standard deviations cover about 86 % instead of 95 %."
)
"""Counted by `python -m tests.studies.joint.beyond`."""
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


def mounts_say(plan: Plan) -> list[str]:
    """What a plan of several mounts cannot show, and what they must keep to; empty for any other."""
    if len(plan.mounts_deg) < 2:
        return []
    return [*_grid_says(plan), *([SEATS_SAY] if plan.mount_axis[-1] == "x" else [])]


def _grid_says(plan: Plan) -> list[str]:
    if plan.jitter_deg or len(set(plan.elevations())) > FEW_ANGLES:
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


LATEST = 5
"""Of a rig's completed runs, whose median counts: one may have been paused, or its machine busy."""


def wall_pace(rig: RigSettings, store: Store) -> float:
    """Seconds on the wall for one that `estimate` says, over the rig's last runs; before any, as set.

    A run tells where its plan says how long it takes and nobody is waited for: not one that may end early or
    whose dwells do, a wait for a temperature, several mounts, a follow-up, or one that was interrupted.
    """
    latest, _ = store.runs.page(rig=rig.name, status="completed", limit=LATEST)
    paces = [pace for run in latest if (pace := _pace_of(run, rig, store)) is not None]
    return median(paces) if paces else 1.0 / rig.time_scale


def _pace_of(run: Run, rig: RigSettings, store: Store) -> float | None:
    if run.plan is None or run.follows or run.provenance.get("interruptions"):
        return None
    if run.started_at is None or run.finished_at is None:
        return None
    plan = Plan.model_validate(run.plan)
    if plan.until or plan.target_std_deg or plan.wait_temperature_c is not None or len(plan.mounts_deg) > 1:
        return None
    try:
        said_s = estimate(plan, rig, store).duration_s
    except Invalid:
        return None  # of other limits than today's
    expected_s = said_s + paused_s(run, _poses(store, run), rig)
    return (run.finished_at - run.started_at).total_seconds() / expected_s


REACHED = Ending(may_be_early=True, stopped_by="until")


@dataclass(frozen=True, slots=True)
class StoppingRule:
    """What a run is to reach, and what its result follows from beside its poses.

    Attributes:
        accepted: effects in force for the unit and its rig; a bench of a centre knows of none.
    """

    until: Until
    planned: Sequence[PlannedPose]
    accepted: Sequence[AcceptedEffect]
    provenance: Document

    def reached(self, poses: Sequence[Pose]) -> bool:
        """Whether the result that the run would have, should it end now, is good enough."""
        stage_map = map_of(self.provenance)
        poses = poses if stage_map is None else with_map(poses, stage_map)
        visited_deg = [pose.target_deg for pose in poses]
        planned_deg = [pose.target_deg for pose in self.planned]
        if not (has_the_line(visited_deg, planned_deg) and turned_both_ways(poses)):
            return False
        return holds(self.until, fitted(poses, self.accepted, self.provenance, ending=REACHED))


def holds(until: Until, result: FittedResult) -> bool:
    """Whether a result states what is wanted; its expanded uncertainty is that of the unit's calibration."""
    expanded_deg = None if result.over_range is None else result.over_range.expanded_uncertainty_deg
    return goals_of(until).reached_by(expanded_deg, result.bias_std_deg, result.scale_std)


def goals_of(until: Until) -> Goals:
    """The same, as plans are designed for it."""
    return Goals(until.expanded_uncertainty_deg, until.bias_std_deg, until.scale_std)


PLACE = "plan.until.expanded_uncertainty_deg"


def reference_uncertainty(
    rig: RigSettings,
    unit: str,
    elevations_deg: Sequence[float],
    store: Store | None,
    in_force: Document | None,
) -> TypeB | None:
    """What the reference makes of a calibrated elevation; None where it is not known.

    `elevations_deg` are those of a sweep of the plan; `store`, which has what was accepted, is None where
    there is none yet; `in_force` is what the run keeps of the stage's map, None without one.
    """
    if in_force is not None:
        theta_deg = np.array(elevations_deg, dtype=np.float64)
        accepted = () if store is None else store.effects.in_force(unit, rig.name)
        bent = any(effect.unit is not None for effect in accepted)
        middle = np.zeros(len(theta_deg))  # of the play: from which side each is come to is not known yet
        found = map_reference(StageMap.from_frozen(in_force), theta_deg, theta_deg, middle, bent=bent)
        return TypeB(found.std_deg, None)
    stated = rig.reference
    if stated is None or stated.std_deg is None:
        return None
    return TypeB(stated.std_deg, Reference(stated.std_deg, stated.kind, stated.distribution))


def require_reachable(
    plan: Plan, rig: RigSettings, unit: str, store: Store, in_force: Document | None
) -> None:
    """Raises Invalid where no run of a plan could end by its `until`: the reference is not worth so much.

    Arguments as of `reference_uncertainty`.
    """
    if plan.until is None or plan.until.expanded_uncertainty_deg is None:
        return
    if in_force is None and rig.reference is None:
        raise Invalid(
            f"rig {rig.name!r} has no `reference` in calrig.toml, so its expanded uncertainty is unknown and "
            "cannot end a run: add it there, or remove this goal",
            [PLACE],
        )
    if in_force is None and rig.reference is not None and rig.reference.map is not None:
        return  # a centre does not know the map that a file of its bench gives
    worth = reference_uncertainty(rig, unit, plan.elevations(), store, in_force)
    below = None if worth is None else worth.why_beyond(goals_of(plan.until))
    if below is not None:
        raise Invalid(below, [PLACE])
