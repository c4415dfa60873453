"""Resume an interrupted run: load its poses, and check that rig, board, stage and unit are unchanged.

The last pose is measured again with the same approach direction; its reading must repeat. The board's clock
starts again at 0. The run's time continues by the wall clock from its start, or from its last sample if the
clocks of the rig run faster than real time.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from calrig.analysis.calibration_in_force import ActiveCalibration, active_calibration
from calrig.analysis.errors import Conflict, NotTheSame
from calrig.analysis.stage_maps import provenance_part
from calrig.analysis.stored_runs import unresolved
from calrig.calibration.poses import Pose
from calrig.estimation.angles import wrap_deg
from calrig.estimation.gyro import GyroBias, dwell_bias
from calrig.estimation.reading import Reading
from calrig.model.plan import Plan, PlanError
from calrig.runs import assignment
from calrig.runs.assignment import Earlier, RunAssignment
from calrig.runs.follow_up import FollowUpRun
from calrig.runs.plan_estimates import planned_poses
from calrig.runs.rig import Rig, require_in_date
from calrig.settings import RigSettings
from calrig.store import Run, Store
from calrig.store.records import Document

MAY_DIFFER = ("port", "baudrate")
"""Of a rig: where its devices are plugged in today."""
VELOCITY = "velocity_dps"
"""A stage keeps what the interrupted run has set."""
GAP_S = 1.0
"""Between the last sample before and the first one after, at least."""
MOVE_OFF_DEG = 5.0
"""More than any play."""
CHANCE_STD = 6.0
REMOUNTED_DEG = 0.5
"""More than a unit turns by itself: 19 °C of warm-up turn an MPU-6050 by 0.28° (the measured warm-up log)."""


def resumed_task(store: Store, run: Run, settings: RigSettings, stage_at_deg: float | None) -> RunAssignment:
    """What is left of an interrupted run.

    `stage_at_deg` is a person's word for the elevation at which a stage without homing stands.

    Raises:
        Conflict: it cannot go on, because the rig was configured otherwise, and how.
    """
    known = run.provenance.get("rig")
    if known is not None:
        now = settings.model_dump(mode="json", exclude={"filter", "simulated", "clamp"})
        _require_same(run.id, f"rig {settings.name!r}", known, now)
    plan = Plan.model_validate(run.plan)
    try:
        planned = plan.poses(settings.limits_deg)
    except PlanError as error:
        raise Conflict(f"run {run.id} cannot be resumed: {error}") from error
    taken = store.spool.taken_order(run.id)
    order = {} if taken is None else taken.document  # which knows more than a bench's own spool
    return RunAssignment(
        run=run,
        rig=settings,
        plan=plan,
        planned=planned,
        follow_up=assignment.follow_up_of(order, plan, settings) or _follow_up(store, run, plan, settings),
        verifies=assignment.verified(order) or _verified(store, run, plan, settings),
        earlier=_earlier(store, run, plan),
        interruption={
            "after_poses": run.progress.poses_done,
            "reason": run.error,
            "resumed_at": datetime.now(UTC).isoformat(timespec="seconds"),
        },
        stage_at_deg=stage_at_deg,
    )


def waiting_task(
    store: Store, run: Run, settings: RigSettings, maps: Mapping[str, Document]
) -> RunAssignment:
    """A run whose turn has come, of which nothing has been done: by the stage's map that is in force now.

    Raises:
        Invalid: an elevation lies beyond the rig's limits, as they are configured now.
        Conflict: a certificate is overdue; the revision that a verification is to apply is not there.
    """
    require_in_date(settings)
    plan = Plan.model_validate(run.plan)
    verifies = _verified(store, run, plan, settings)
    origin = {key: value for key, value in run.provenance.items() if key != "stage_map"}
    now = run.model_copy(update={"provenance": {**origin, **provenance_part(store, settings.name, maps)}})
    return RunAssignment(now, settings, plan, planned_poses(plan, settings), verifies=verifies)


def _verified(store: Store, run: Run, plan: Plan, rig: RigSettings) -> ActiveCalibration | None:
    """The revision that a verification began with; runs from before there were revisions name none."""
    if plan.kind != "verification":
        return None
    return active_calibration(store, run.unit, rig.name, run.provenance.get("verifies_revision"))


def require_same_devices(run: Run, rig: Rig) -> None:
    """Raises NotTheSame where another board or stage answers than the run began with; names what differs."""
    for what, identity in (("stage", asdict(rig.stage_identity)), ("board", asdict(rig.board_identity))):
        known = run.provenance.get(what)
        if known is not None:
            _require_same(run.id, f"the {what}", known, {**identity, VELOCITY: known.get(VELOCITY)})


def way_back(last: Pose, limits_deg: tuple[float, float]) -> list[float]:
    """Elevations to go to, in order, so as to stand at a pose as it was approached."""
    low, high = limits_deg
    beside_deg = min(max(last.target_deg - MOVE_OFF_DEG * (last.approach or 0), low), high)
    return [beside_deg, last.target_deg] if beside_deg != last.target_deg else [last.target_deg]


@dataclass(frozen=True, slots=True)
class Returned:
    """The last pose before an interruption, and its reading afterwards."""

    before: Pose
    after: Reading

    @property
    def difference_deg(self) -> float:
        """How much more the unit reads than before."""
        return wrap_deg(self.after.reading_deg - self.before.reading_deg)

    @property
    def std_deg(self) -> float | None:
        """What the difference may be by chance; None where a standard error is not known."""
        errors = (self.before.reading_stderr_deg, self.after.reading_stderr_deg)
        return None if None in errors else math.hypot(*(error or 0.0 for error in errors))

    def require_same_unit(self) -> None:
        """Raises NotTheSame where the unit must have been touched meanwhile."""
        if abs(self.difference_deg) > max(REMOUNTED_DEG, CHANCE_STD * (self.std_deg or 0.0)):
            raise NotTheSame(
                f"at {self.before.target_deg:g}° the reading changed by {self.difference_deg:+.3f}° across "
                "the interruption: unit, mount or stage zero has moved, or the unit was exchanged; start "
                "a new run"
            )

    def document(self) -> dict[str, Any]:
        """As it is kept with the run."""
        return {
            "target_deg": self.before.target_deg,
            "before_deg": self.before.reading_deg,
            "after_deg": self.after.reading_deg,
            "difference_deg": self.difference_deg,
            "difference_std_deg": self.std_deg,
        }

    def warnings(self) -> list[str]:
        """What a person should know of it."""
        if self.std_deg is None or abs(self.difference_deg) <= CHANCE_STD * self.std_deg:
            return []
        return [
            f"at {self.before.target_deg:g}° the reading changed by {self.difference_deg:+.3f}° across "
            f"the interruption, more than {CHANCE_STD:g} standard errors ({CHANCE_STD * self.std_deg:.3f}°): "
            "run the diagnosis to see whether the unit drifted or slipped"
        ]


def _require_same(run_id: str, what: str, known: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    differ = _differences(known, now)
    if differ:
        raise NotTheSame(
            f"run {run_id} cannot be resumed, for {what} is not what it was: {'; '.join(differ)}; "
            "nothing was moved: put it back, or start a new run"
        )


def _differences(known: Mapping[str, Any], now: Mapping[str, Any], within: str = "") -> list[str]:
    found: list[str] = []
    for key in known.keys() & now.keys() - set(MAY_DIFFER):
        then, today = _plain(known[key]), _plain(now[key])
        if isinstance(then, dict) and isinstance(today, dict):
            found += _differences(then, today, f"{within}{key}.")
        elif then != today:
            found.append(f"{within}{key} was {then!r} and is {today!r}")
    return sorted(found)


def _plain(value: Any) -> Any:
    """As JSON keeps it."""
    return list(value) if isinstance(value, tuple) else value


def _earlier(store: Store, run: Run, plan: Plan) -> Earlier:
    poses = [stored.pose for stored in store.poses.of(run.id)]
    times_s = store.samples.of(run.id).time_s
    last_s = float(times_s[-1]) + GAP_S if len(times_s) else 0.0
    since_s = 0.0 if run.started_at is None else (datetime.now(UTC) - run.started_at).total_seconds()
    begun = bool(poses) or bool(len(times_s))
    return Earlier(
        poses=poses,
        biases=_biases(store, run, poses),
        logged_s=plan.dwell_s * run.progress.fraction if plan.kind == "static" else 0.0,
        clock_s=max(last_s, since_s, poses[-1].time_s or 0.0 if poses else 0.0) if begun else 0.0,
        faults={**run.faults, "interrupted": run.faults.get("interrupted", 0) + 1},
    )


def _biases(store: Store, run: Run, poses: list[Pose]) -> list[GyroBias]:
    dwells = [store.samples.of(run.id, index).gyro_dps for index in range(len(poses))]
    return [dwell_bias(np.asarray(gyro_dps)) for gyro_dps in dwells if len(gyro_dps)]


def _follow_up(store: Store, run: Run, plan: Plan, settings: RigSettings) -> FollowUpRun | None:
    """As it began: its decisions rest on poses that are stored, so they come out alike."""
    if run.follows is None:
        return None
    known = run.provenance.get("follow_up") or {}
    if "deciding" not in known:
        raise Conflict(f"run {run.id} follows {run.follows} and was begun by an older calrig: start it anew")
    earlier = unresolved(store, run.follows)
    return FollowUpRun(earlier, known["separates"], known["deciding"], plan, settings.limits_deg)
