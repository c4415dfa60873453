"""Run service of this machine: starts runs, one at a time on each rig, and forwards requests to them."""

import logging
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.revisions import Issuer, Releases
from calrig.model.plan import MountAxis
from calrig.model.service import RigState
from calrig.runs.assignment import NewRun, RunAssignment
from calrig.runs.control import End
from calrig.runs.crew import Clamps, WorkerRegistry
from calrig.runs.plan_estimates import planned_poses, require_reachable
from calrig.runs.presence import BoardCheck, PresenceMonitor
from calrig.runs.recorder import Bus, ServiceMetrics, check_transition
from calrig.runs.resume import resumed_task, waiting_task
from calrig.runs.rig import check_stage_at, require_in_date
from calrig.runs.rig_status import state_of
from calrig.runs.run_queue import RunQueue
from calrig.runs.services import Service
from calrig.runs.single_flight import SharedTask
from calrig.runs.stopping import STOPPED, StopService
from calrig.runs.worker import Worker
from calrig.settings import RigSettings
from calrig.store import Run, Store, StoreError
from calrig.store.records import Document
from calrig.store.trail import Act

log = logging.getLogger(__name__)

ANSWER_S = 2.0
"""How long a request to end waits, once the stage stands, for the run to say that it has ended."""
CLOSE_S = 4.0
"""How long the service waits for all of its runs together when it is told to go."""


class RunService(Service):
    """Runs on the rigs of this machine. Thread-safe.

    Args:
        record: folder for transcripts of every byte on the rigs' wires; None for none.
        issuer: makes drafts of completed calibrations; without it by what the rigs' `release` says.
        maps: as of `Service`.
    """

    def __init__(
        self,
        store: Store,
        rigs: Sequence[RigSettings],
        record: Path | None = None,
        issuer: Issuer | None = None,
        maps: Mapping[str, Document] = MappingProxyType({}),
    ) -> None:
        self.store = store
        self.maps = maps
        self._issuer = issuer or Issuer(store, Releases.of(rigs))
        self.bus = Bus()
        self._rigs = {rig.name: rig for rig in rigs}
        self.meter = ServiceMetrics(self._rigs)
        self.crew = WorkerRegistry()
        self._stops = StopService(self.crew)
        self._record = record
        self._lock = threading.Lock()  # held while a run takes a rig and the store records it
        self._queue = RunQueue(
            store, self.bus, self.meter, self._lock, self._require_ready, self._begin_queued
        )
        self._clamps = Clamps(self.crew, self._queue.next)
        self._presence = PresenceMonitor(store, self.crew)

    @property
    def issuer(self) -> Issuer:
        """Makes drafts of completed calibrations."""
        return self._issuer

    def rigs(self) -> list[RigState]:
        """Every configured rig and what it is doing. Looks at no port that would notice."""
        busy, unreachable = self.crew.look()
        return [
            state_of(rig, busy.get(rig.name), unreachable=rig.name in unreachable)
            for rig in self._rigs.values()
        ]

    def start_on(self, rig: str | None, wanted: NewRun, *, waits: bool = False) -> Run:
        """As `begin`, on the rig of a name; on the first one configured without."""
        return self.begin(self.known_rig(rig), wanted, waits=waits)

    def begin(self, settings: RigSettings, wanted: NewRun, *, waits: bool = False) -> Run:
        """Start a run on a rig of this service, which is free or kept for that run; errors as of `start`.

        With `waits` the run is stored as `queued` if the rig is not free, and starts once it is.
        """
        plan = wanted.plan
        require_in_date(settings)
        planned = planned_poses(plan, settings)
        wanted = wanted.as_of_now(self.store, settings.name, self.maps)
        require_reachable(plan, settings, wanted.unit, self.store, wanted.origin.get("stage_map"))
        with self._lock:
            self._clamps.require_still(settings.name)
            try:
                self.crew.require_free(settings.name, wanted.run_id)
                self._queue.require_nobody(settings.name)
            except Conflict:
                if not waits or self.crew.is_closing:
                    raise
                run = self._wait_in_turn(settings.name, wanted, len(planned))
            else:
                run = wanted.keep(self.store, settings.name, len(planned))
                task = RunAssignment(
                    run,
                    settings,
                    plan,
                    planned,
                    wanted.follow_up,
                    wanted.verifies,
                    stage_at_deg=wanted.stage_at_deg,
                )
                self._start_worker(task)
        return self.run(run.id)

    def _start_worker(self, task: RunAssignment) -> None:
        """Start the worker of a run; call it under the lock."""
        left = self.crew.left_rig
        worker = Worker(task, self.store, self._issuer, self.bus, self.meter, left, self._ended, self._record)
        if self.crew.take(worker):
            worker.control.end(End("aborted", STOPPED))
        worker.start(self._presence.let_go(worker.rig.name))

    def _wait_in_turn(self, rig_name: str, wanted: NewRun, n_poses: int) -> Run:
        if wanted.stage_at_deg is not None:
            raise Conflict(
                "stage_at_deg is not allowed for a queued run: earlier runs move the stage; start this run "
                "when the rig is idle"
            )
        run = wanted.keep(self.store, rig_name, n_poses)
        self._queue.add(run)
        return run

    def _begin_queued(self, run: Run) -> None:
        """Start a queued run whose rig is free."""
        settings = self._rigs.get(run.rig or "")
        if settings is None:
            raise Conflict(f"rig {run.rig!r} is not configured any more")
        self._start_worker(waiting_task(self.store, run, settings, self.maps))

    def _require_ready(self, rig_name: str) -> None:
        self.crew.require_free(rig_name)
        self._clamps.require_still(rig_name)

    def _ended(self, worker: Worker) -> None:
        self.crew.ended(worker)
        self._queue.next(worker.rig.name)

    def run(self, run_id: str) -> Run:
        """The run, or Unknown. One whose end the store could not be told of yet is as it ended."""
        worker = self.crew.of_run(run_id)  # before the store is asked: it is let go once that is told
        untold = None if worker is None else worker.untold
        run = super().run(run_id)
        return run if untold is None else run.model_copy(update=untold)

    def abort(self, run_id: str, who: str | None = None) -> Run:
        """Stops the stage now and ends the run; returns once it has ended, or two seconds after the stage.

        A run that waits its turn will not begin, an interrupted one not be resumed. `who` asks for it is
        entered in the trail with the run's end.

        Raises:
            Unknown: there is no such run.
            Conflict: it has ended, or its stage is not known to stand; says why and what to do.
        """
        if errand := self.begin_abort(run_id, who):
            return errand.result()
        with self._lock:
            if self._queue.take_out(run_id, who):
                return self.run(run_id)
            run = self.run(run_id)
            if run.status == "interrupted" and self.crew.of_run(run_id) is None:
                asked = Act("aborted", who)
                aborted = self.store.runs.update(run_id, status="aborted", asked=asked)
                self.bus.wake(run_id)
                return aborted
        return self._aborted(self._worker(run_id, "aborted"), who)

    def begin_abort(self, run_id: str, who: str | None = None) -> SharedTask[Run] | None:
        """As `abort`, in a thread of its own; None where nobody carries the run out. Asks no store before."""
        worker = self.crew.of_run(run_id)
        return None if worker is None else self._stops.abort(worker, lambda: self._aborted(worker, who))

    def _aborted(self, worker: Worker, who: str | None) -> Run:
        self._stops.stop_run(worker, End("aborted", None, who))
        worker.join(ANSWER_S)
        try:
            return self.run(worker.run_id)
        except StoreError as error:  # of a stop that was made, the store's trouble makes no failure
            log.error("run %s was aborted and cannot be read: %s", worker.run_id, error)
            return worker.as_known

    def begin_stop(self, rig_name: str, who: str | None = None) -> SharedTask[RigState]:
        """Stops a rig's stage now, whatever runs: a run on it is aborted, an idle stage is told by itself.

        What waits for the rig is aborted as well. It is done, once the stage was seen to stand, in a thread
        that is this rig's alone; who asks while it is being told shares that. `who` is entered in the trail
        with the end of each run that this aborts.

        Raises:
            Unknown: there is no such rig.
            Conflict: as the task's result; it is not known to stand; says why and what to do.
        """
        rig = self.known_rig(rig_name)
        self.crew.call_off(rig_name)
        # Beside the stop, which waits for no store; a daemon, for a store that hangs is to keep no process.
        tell = self._queue.call_off(rig_name, who)
        telling = threading.Thread(target=tell, name=f"call-off at {rig_name}", daemon=True)
        telling.start()

        def stopped() -> RigState:
            telling.join(ANSWER_S)
            return self._state_of(rig)

        return self._stops.stop(rig, stopped, who)

    def begin_clamp(self, rig_name: str, mount_deg: float, axis: MountAxis) -> SharedTask[RigState]:
        """Has a rig's clamp turn the unit, in a thread of its own; errors as of `Clamps.turn`, or Unknown."""
        rig = self.known_rig(rig_name)
        with self._lock:
            return self._clamps.turn(rig, mount_deg, axis, lambda: self._state_of(rig))

    def look(self, rig_name: str) -> None:
        """Has an idle rig's board looked at for a while: whether a unit is there, and which. Or Unknown."""
        self._presence.look(self.known_rig(rig_name))

    def looks(self) -> dict[str, BoardCheck]:
        """What the last looks at boards gave, by rig; of those that are looked at."""
        return self._presence.looks()

    def _state_of(self, rig: RigSettings) -> RigState:
        return next(state for state in self.rigs() if state.name == rig.name)

    def pause(self, run_id: str, who: str | None = None) -> Run:
        """Has the run hold after the pose in hand; then `who` is entered in the trail."""
        self._worker(run_id, "paused").control.pause(who)
        return self.run(run_id)

    def resume(self, run_id: str, stage_at_deg: float | None = None, who: str | None = None) -> Run:
        """Has a paused run go on, or takes the wish for a pause back; resumes an interrupted run.

        A run that waited while the service was started anew waits its turn again. `stage_at_deg` is a
        person's word for the elevation at which the stage of an interrupted run stands, if it has no homing.
        `who` is entered in the trail as the run goes on.

        Raises:
            Unknown: there is no such run.
            Invalid: its stage has homing, and an elevation was given.
            Conflict: it is neither paused nor interrupted; its rig is busy, not configured any more, or
                configured otherwise, and how; the unit that it waits for is not clamped as asked, by gravity.
        """
        run = self.run(run_id)
        check_stage_at(run, stage_at_deg)
        if run.status == "interrupted":
            return self._resume_interrupted(run, stage_at_deg, who)
        if self._queue.go(run_id, who):
            return self.run(run_id)
        self._worker(run_id, "resumed").go_on(who)
        return self.run(run_id)

    def _resume_interrupted(self, run: Run, stage_at_deg: float | None, who: str | None) -> Run:
        settings = self._rigs.get(run.rig or "")
        if settings is None:
            raise Conflict(
                f"run {run.id} was on rig {run.rig!r}, which is not configured any more: configure it again, "
                "or end the run"
            )
        require_in_date(settings)
        task = resumed_task(self.store, run, settings, stage_at_deg)
        with self._lock:
            self.crew.require_free(settings.name, run.id)
            check_transition(run.id, self.run(run.id).status, "queued")  # somebody else may have been first
            asked = Act("resumed", who)
            self.store.runs.update(run.id, status="queued", error=None, asked=asked)
            self._start_worker(task)
        return self.run(run.id)

    def _worker(self, run_id: str, wish: str) -> Worker:
        worker = self.crew.of_run(run_id)
        if worker is None:
            raise Conflict(f"run {run_id} is {self.run(run_id).status} and cannot be {wish}")
        return worker

    def wait(self, run_id: str, timeout_s: float | None = None) -> Run:
        """The run once it has ended, or as it is after timeout_s."""
        worker = self.crew.of_run(run_id)
        if worker is not None:
            worker.join(timeout_s)
        return self.run(run_id)

    def close(self) -> None:
        """Stops every stage and ends every run as `interrupted`, within five seconds."""
        end = End("interrupted", "the service was stopped during the run")
        with self._lock:
            workers = self.crew.close()
        for worker in workers:
            worker.control.end(end)
        deadlines_s = [worker.clock.now_s() + CLOSE_S for worker in workers]
        self._presence.close()
        for worker, deadline_s in zip(workers, deadlines_s, strict=True):
            worker.join(max(0.0, deadline_s - worker.clock.now_s()))
            worker.give_up(self.store, end)

    def ports(self) -> list[str]:
        """The ports of all rigs."""
        return [part.port for rig in self._rigs.values() for part in rig.devices]

    def known_rig(self, name: str | None) -> RigSettings:
        """A rig's settings, those of the first one without a name; Unknown where no such is configured."""
        if name is None:
            return next(iter(self._rigs.values()))
        if name not in self._rigs:
            raise Unknown(f"there is no rig {name!r}; configured: {', '.join(sorted(self._rigs))}")
        return self._rigs[name]
