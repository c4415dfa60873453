"""Record a run: store each state, pose and reading before it is published; count for the metrics."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Unpack

from prometheus_client import CollectorRegistry, Counter, Gauge

from calrig.analysis.errors import Conflict
from calrig.analysis.stored_runs import mount_columns
from calrig.calibration.poses import GYRO_MEANS, Pose
from calrig.calibration.results import raw_error_deg
from calrig.instruments.clock import Clock
from calrig.model.run import AT_REST, TERMINAL, Mount, Progress, Status
from calrig.store import Announced, RunChanges, SampleBlock, Store
from calrig.store.issued import Draft
from calrig.store.trail import Act


class Bus:
    """Wake-up calls per run, from run threads to any number of watchers."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._watchers: dict[str, list[Callable[[], None]]] = {}
        self._hearing: list[Callable[[str], None]] = []

    def hear(self, heard: Callable[[str], None]) -> None:
        """Has `heard` called with the run after each commit of new events of any run."""
        with self._lock:
            self._hearing.append(heard)

    def subscribe(self, run_id: str, wake: Callable[[], None]) -> Callable[[], None]:
        """Has `wake` called after each commit of new events of the run; returns the way to end it."""
        with self._lock:
            self._watchers.setdefault(run_id, []).append(wake)

        def unsubscribe() -> None:
            with self._lock:
                watchers = self._watchers.get(run_id, [])
                if wake in watchers:
                    watchers.remove(wake)
                if not watchers:
                    self._watchers.pop(run_id, None)

        return unsubscribe

    def wake(self, run_id: str) -> None:
        """Calls everybody who watches the run."""
        with self._lock:
            watchers, hearing = list(self._watchers.get(run_id, ())), list(self._hearing)
        for wake in watchers:
            wake()
        for heard in hearing:
            heard(run_id)

    def wake_all(self) -> None:
        """Calls everybody: what happened meanwhile was not heard."""
        with self._lock:
            watchers = [wake for watching in self._watchers.values() for wake in watching]
        for wake in watchers:
            wake()


class ServiceMetrics:
    """The counters of a service, in a registry of its own; each run counts through a `RunMeter` of its rig.

    Args:
        rigs: their names. What is counted by rig begins with 0, for a rate needs a beginning.

    Attributes:
        registry: what the service's metrics are written out from.
    """

    def __init__(self, rigs: Iterable[str] = ()) -> None:
        registry = self.registry = CollectorRegistry()
        self.samples = Counter(
            "calrig_samples", "Valid samples taken from boards.", ["rig"], registry=registry
        )
        self.poses = Counter("calrig_poses", "Poses measured and stored.", ["rig"], registry=registry)
        self.faults = Counter(
            "calrig_faults",
            "Faults seen on the wires and in samples.",
            ["rig", "kind"],
            registry=registry,
        )
        self.ended = Counter("calrig_runs_ended", "Runs that ended.", ["rig", "status"], registry=registry)
        began_s = time.monotonic()
        uptime = Gauge("calrig_uptime_seconds", "Time since the service began.", registry=registry)
        uptime.set_function(lambda: time.monotonic() - began_s)
        for rig in rigs:
            self.samples.labels(rig)
            self.poses.labels(rig)

    def of_run(self, rig: str, faults_before: Mapping[str, int] | None = None) -> RunMetrics:
        """A meter for one run on a rig; of a resumed one, `faults_before` were counted before."""
        return RunMetrics(self, rig, faults_before or {})


class RunMetrics:
    """What one run counts. Used by the run's own thread only."""

    def __init__(self, meter: ServiceMetrics, rig: str, faults_before: Mapping[str, int]) -> None:
        self._meter = meter
        self._rig = rig
        self._faults = dict(faults_before)

    def samples(self, number: int) -> None:
        """Samples came."""
        self._meter.samples.labels(self._rig).inc(number)

    def pose(self) -> None:
        """A pose was stored."""
        self._meter.poses.labels(self._rig).inc()

    def faults(self, totals: Mapping[str, int]) -> None:
        """The run's faults so far, by kind: the difference to the last totals is new."""
        for kind, total in totals.items():
            self._meter.faults.labels(self._rig, kind).inc(max(0, total - self._faults.get(kind, 0)))
            self._faults[kind] = total

    def ended(self, status: str) -> None:
        """The run ended."""
        self._meter.ended.labels(self._rig, status).inc()


ALLOWED: dict[str, frozenset[str]] = {
    "queued": frozenset({"running", "failed", "aborted", "interrupted"}),
    "running": frozenset({"paused", "completed", "failed", "aborted", "interrupted"}),
    "paused": frozenset({"running", "failed", "aborted", "interrupted"}),
    "interrupted": frozenset({"queued", "aborted"}),
    **{status: frozenset() for status in TERMINAL},
}


def check_transition(run_id: str, before: str, after: str) -> None:
    """Raises Conflict where a run may not go from `before` to `after`."""
    if after not in ALLOWED[before]:
        raise Conflict(f"run {run_id} is {before} and cannot become {after}")


log = logging.getLogger(__name__)

READING_INTERVAL_S = 0.05
"""Readings go out at most twenty times a second (CONTRACT section 2)."""
FLUSH_INTERVAL_S = 0.25
"""How long readings may wait for one another: a commit each would cost a disk twenty syncs a second."""


class Recorder:
    """One run's way into the store and out to those who watch. Used by the run's own thread only.

    `axis` is which of its unit's lies along the stage's.
    """

    def __init__(
        self,
        store: Store,
        bus: Bus,
        run_id: str,
        meter: RunMetrics,
        clock: Clock,
        poses_total: int,
        poses_before: int = 0,
        axis: str = "x",
    ) -> None:
        self._now_s = clock.now_s
        self._store = store
        self._bus = bus
        self.run_id = run_id
        self.meter = meter
        self._axis = axis
        self._status: Status = "queued"
        self._poses_total = poses_total
        self._poses_done = self._poses_before = poses_before
        self._planned_s: Sequence[float] = [1.0] * poses_total
        self._first_pose_began_s = self._now_s()
        self._paused_s = 0.0
        self._waiting_for: Mount | None = None
        self._clamped_at: Callable[[float, float], float] = lambda _stage_deg, reading_deg: reading_deg
        self._readings: list[tuple[str, dict[str, Any]]] = []
        self._last_reading_s = self._last_flush_s = -math.inf

    def state(
        self,
        status: Status,
        changes: RunChanges | None = None,
        draft: Draft | None = None,
        asked: Act | None = None,
    ) -> None:
        """Changes the run's status and says so; all that is given is stored in the same transaction.

        `asked` is what somebody asked for, by which the status changes.
        """
        check_transition(self.run_id, self._status, status)
        self.flush()
        told: RunChanges = {**(changes or {}), "status": status}
        if self._waiting_for is not None:
            self._waiting_for = None
            told["progress"] = self._progress()
        self._become(status, told, draft, asked)

    def waits_for(self, asked: Mount, clamped_at: Callable[[float, float], float]) -> None:
        """The run is paused until a person has done what is asked; any other state ends that.

        `clamped_at` tells, by stage and reading, at which angle the unit is clamped.
        """
        check_transition(self.run_id, self._status, "paused")
        self.flush()
        self._waiting_for, self._clamped_at = asked, clamped_at
        self._become("paused", {"status": "paused", "progress": self._progress()})

    def _become(
        self, status: Status, told: RunChanges, draft: Draft | None = None, asked: Act | None = None
    ) -> None:
        events = [("progress", told["progress"].model_dump())] if "progress" in told else []
        self._store.runs.update(self.run_id, events=events, draft=draft, asked=asked, **told)
        self.meter.faults(told.get("faults", {}))
        if status in AT_REST:
            self.meter.ended(status)
        error = told.get("error")
        level = logging.WARNING if status in {"failed", "interrupted"} else logging.INFO
        log.log(level, "run %s is %s%s", self.run_id, status, f": {error}" if error else "")
        if status == "paused":
            self._paused_s = self._now_s()
        elif self._status == "paused":  # a pause says nothing of how long poses take
            self._first_pose_began_s += self._now_s() - self._paused_s
        self._status = status
        self._bus.wake(self.run_id)

    def poses_begin(self, planned_s: Sequence[float] = ()) -> None:
        """The first pose begins: the time left is computed from here.

        Args:
            planned_s: about what each pose of the plan takes, by the plan; without it all take as long.
        """
        self._first_pose_began_s = self._now_s()
        self._planned_s = planned_s or self._planned_s

    def update(self, **changes: Unpack[RunChanges]) -> None:
        """Stores what nobody is told of."""
        self._store.runs.update(self.run_id, **changes)

    def skip_pose(self) -> None:
        """One planned pose will not be measured."""
        self._poses_total -= 1

    def is_the_last(self) -> None:
        """None will be measured after the pose that is told next."""
        self._poses_total = self._poses_done + 1

    def end_here(self) -> None:
        """None of the planned poses that are left will be measured; announces how far the run has come."""
        self.flush()
        self._poses_total = self._poses_done
        progress = self._progress()
        self._store.runs.update(self.run_id, events=[("progress", progress.model_dump())], progress=progress)
        self._bus.wake(self.run_id)

    def pose(
        self, index: int, pose: Pose, blocks: list[SampleBlock], faults: Mapping[str, int], *also: Announced
    ) -> None:
        """Stores a finished pose with its samples; announces it, its progress, and what `also` tells."""
        self.flush()
        self._poses_done += 1
        progress = self._progress()
        mount = mount_columns(self.run_id, self._axis, pose)
        sense = -1 if self._axis.startswith("-") else 1
        told = {
            "index": index,
            **dict.fromkeys(GYRO_MEANS),
            **pose.row(),
            **mount,
            "raw_error_deg": raw_error_deg(pose, sense),
        }
        events: list[Announced] = [("pose", told), ("progress", progress.model_dump()), *also]
        self._store.poses.add(
            self.run_id, index, pose, blocks, events, progress=progress, faults=dict(faults)
        )
        self.meter.pose()
        self.meter.faults(faults)
        self._bus.wake(self.run_id)

    def log(self, block: SampleBlock, done_s: float, left_s: float, faults: Mapping[str, int]) -> None:
        """Stores the next stretch of a static log, and announces how far it has come."""
        self.flush()
        progress = Progress(
            poses_done=0,
            poses_total=0,
            fraction=done_s / (done_s + left_s),
            remaining_s=round(left_s, 1),
        )
        self._store.samples.add(
            self.run_id,
            [block],
            [("progress", progress.model_dump())],
            progress=progress,
            faults=dict(faults),
        )
        self.meter.faults(faults)
        self._bus.wake(self.run_id)

    def reading(
        self, time_s: float, stage_deg: float | None, reading_deg: float | None, temperature_c: float | None
    ) -> None:
        """Tells what is seen now, unless something was told less than a twentieth of a second ago."""
        now_s = self._now_s()
        if now_s - self._last_reading_s < READING_INTERVAL_S:
            return
        self._last_reading_s = now_s
        data = {
            "time_s": round(time_s, 6),
            "stage_deg": stage_deg,
            "reading_deg": reading_deg,
            "temperature_c": temperature_c,
        }
        if self._waiting_for is not None and stage_deg is not None and reading_deg is not None:
            data["mount_deg"] = round(self._clamped_at(stage_deg, reading_deg), 2)
        self._readings.append(("reading", data))
        if now_s - self._last_flush_s >= FLUSH_INTERVAL_S:
            self.flush()

    def flush(self) -> None:
        """Writes the readings that wait."""
        self._last_flush_s = self._now_s()
        if self._readings:
            self._store.events.append(self.run_id, self._readings)
            self._readings = []
            self._bus.wake(self.run_id)

    def _progress(self) -> Progress:
        remaining_s = None
        measured_s = sum(self._planned_s[self._poses_before : self._poses_done])
        if measured_s:
            pace = (self._now_s() - self._first_pose_began_s) / measured_s
            remaining_s = round(pace * sum(self._planned_s[self._poses_done : self._poses_total]), 1)
        return Progress(
            poses_done=self._poses_done,
            poses_total=self._poses_total,
            fraction=self._poses_done / self._poses_total,
            remaining_s=remaining_s,
            waiting_for=self._waiting_for,
        )
