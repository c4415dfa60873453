"""Runs as people and programs ask for them: one at a time on each rig, side by side on several."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calrig.analysis.active_calibration import active_calibration
from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.origin import check_serial, provenance
from calrig.analysis.stored_runs import stored_run
from calrig.analysis.unresolved import unresolved
from calrig.instruments.errors import InstrumentError
from calrig.plan import Plan
from calrig.processes.pool import Apart, run_apart
from calrig.runs.bus import Bus
from calrig.runs.control import End
from calrig.runs.follow_up import FollowUpRun
from calrig.runs.meter import Meter
from calrig.runs.planned import planned_poses
from calrig.runs.resume import resumed_task
from calrig.runs.rig import stop_stage
from calrig.runs.rig_states import RigState, state_of
from calrig.runs.stage_place import leave_at
from calrig.runs.states import check_transition
from calrig.runs.task import Task
from calrig.runs.worker import Worker
from calrig.settings import RigSettings
from calrig.store import Run, Store

ANSWER_S = 2.0
"""How long a request to end waits for the run to say that it has ended."""
CLOSE_S = 4.0
"""How long the service waits for all of its runs together when it is told to go."""


class RunService:
    """Starts runs and passes requests on to them. Thread-safe.

    Args:
        store: where runs are kept.
        rigs: those there are.
        record: folder for transcripts of every byte on the rigs' wires; None for none.
    """

    def __init__(self, store: Store, rigs: Sequence[RigSettings], record: Path | None = None) -> None:
        self.store = store
        self.bus = Bus()
        self._rigs = {rig.name: rig for rig in rigs}
        self.meter = Meter(self._rigs)
        self._lock = threading.Lock()
        self._workers: dict[str, Worker] = {}
        self._busy: dict[str, str] = {}  # rigs by name, each with its run
        self._unreachable: set[str] = set()
        self._closing = False
        self._record = record

    def rigs(self) -> list[RigState]:
        """Every configured rig and what it is doing. Looks at no port that would notice."""
        with self._lock:
            busy, unreachable = dict(self._busy), set(self._unreachable)
        return [
            state_of(rig, busy.get(rig.name), unreachable=rig.name in unreachable)
            for rig in self._rigs.values()
        ]

    def start(
        self,
        *,
        unit: str,
        plan: Plan,
        rig: str | None = None,
        operator: str | None = None,
        note: str | None = None,
        stage_at_deg: float | None = None,
    ) -> Run:
        """Starts a run on a rig (the first one configured where none is named) and returns it at once.

        `stage_at_deg` is a person's word for the elevation at which a stage without homing stands.

        Raises:
            Invalid: the serial number or an elevation of the plan is out of bounds; nothing was stored.
            Unknown: there is no such rig.
            Conflict: the rig is busy.
        """
        check_serial(unit)
        settings = self._rig(rig)
        return self._begin(settings, unit, plan, operator=operator, note=note, stage_at_deg=stage_at_deg)

    def follow_up(self, run_id: str, apart: Apart = run_apart) -> Run:
        """Starts the run that best separates what the diagnosis of a run (and those before it) could not.

        Raises:
            Unknown: there is no such run.
            Conflict: nothing can be separated on this rig, and why; or the rig is busy.
        """
        run = stored_run(self.store, run_id)
        if run.rig is None:
            raise Conflict(f"run {run_id} was imported: no rig is known to follow it up on")
        settings = self._rig(run.rig)
        follow_up = FollowUpRun.designed(unresolved(self.store, run_id, apart), settings.limits_deg, apart)
        return self._begin(
            settings, run.unit, follow_up.plan, operator=run.operator, follows=run_id, follow_up=follow_up
        )

    def _begin(
        self,
        settings: RigSettings,
        unit: str,
        plan: Plan,
        *,
        operator: str | None = None,
        note: str | None = None,
        follows: str | None = None,
        follow_up: FollowUpRun | None = None,
        stage_at_deg: float | None = None,
    ) -> Run:
        planned = planned_poses(plan, settings)
        verifies = None
        if plan.kind == "verification":
            verifies = active_calibration(self.store, unit, settings.name)
        with self._lock:
            self._require_free(settings.name)
            if stage_at_deg is not None:
                leave_at(self.store, settings, stage_at_deg)
            run = self.store.create_run(
                unit=unit,
                rig=settings.name,
                plan=plan.model_dump(mode="json"),
                status="queued",
                operator=operator,
                note=note,
                follows=follows,
                provenance={
                    **provenance(operator),
                    "seed": plan.seed,
                    **({} if verifies is None else {"verifies": verifies.run_id}),
                    **({} if follow_up is None else {"follow_up": follow_up.provenance()}),
                },
                poses_total=0 if plan.kind == "static" else len(planned),
            )
            self._employ(Task(run, settings, plan, planned, follow_up, verifies))
        return self.run(run.id)

    def _require_free(self, rig_name: str) -> None:
        if self._closing:
            raise Conflict("the service is shutting down")
        if rig_name in self._busy:
            raise Conflict(f"rig {rig_name!r} is busy with run {self._busy[rig_name]}")

    def _employ(self, task: Task) -> None:
        """Starts a worker; called with the lock held, so that nobody meets a rig half taken."""
        left, ended = self._worker_left_rig, self._worker_ended
        worker = Worker(task, self.store, self.bus, self.meter, left, ended, self._record)
        self._workers[task.run.id] = worker
        self._busy[task.rig.name] = task.run.id
        worker.start()

    def _worker_left_rig(self, worker: Worker) -> None:
        with self._lock:
            del self._busy[worker.rig.name]
            if worker.reached_rig:
                self._unreachable.discard(worker.rig.name)
            else:
                self._unreachable.add(worker.rig.name)

    def _worker_ended(self, worker: Worker) -> None:
        with self._lock:
            del self._workers[worker.run_id]

    def run(self, run_id: str) -> Run:
        """The run, or Unknown. One whose end the store could not be told of yet is as it ended."""
        worker = self._workers.get(run_id)  # before the store is asked: it is let go once that is told
        untold = None if worker is None else worker.untold
        run = stored_run(self.store, run_id)
        return run if untold is None else replace(run, **untold)

    def abort(self, run_id: str) -> Run:
        """Stops the stage now and ends the run; returns once it has ended, or after two seconds.

        An interrupted run, which nobody carries out, will not be resumed.
        """
        with self._lock:
            run = self.run(run_id)
            if run.status == "interrupted" and run_id not in self._workers:
                return self.store.update_run(run_id, status="aborted")
        worker = self._worker(run_id, "aborted")
        worker.control.end(End("aborted", None))
        worker.join(ANSWER_S)
        return self.run(run_id)

    def stop(self, rig_name: str) -> RigState:
        """Stops a rig's stage now, whatever runs: a run on it is aborted, an idle stage is told by itself.

        The stop is sent from the asking thread and waits for no run's loop.

        Raises:
            Unknown: there is no such rig.
            Conflict: the stage could not be told; says why.
        """
        settings = self._rig(rig_name)
        if not self._stop_run_on(settings.name):
            try:
                stop_stage(settings)
            except InstrumentError as error:
                if not self._stop_run_on(settings.name):  # a run may just have taken the port
                    raise Conflict(
                        f"the stage of rig {rig_name!r} cannot be told to stop ({error}): cut its motor power"
                    ) from error
        return next(state for state in self.rigs() if state.name == settings.name)

    def _stop_run_on(self, rig_name: str) -> bool:
        with self._lock:
            worker = self._workers.get(self._busy.get(rig_name, ""))
        if worker is not None:
            worker.control.end(End("aborted", "the stage was stopped by request"))
        return worker is not None

    def pause(self, run_id: str) -> Run:
        """Has the run hold after the pose in hand."""
        self._worker(run_id, "paused").control.pause()
        return self.run(run_id)

    def resume(self, run_id: str) -> Run:
        """Has a paused run go on, or takes the wish for a pause back; resumes an interrupted run.

        Raises:
            Unknown: there is no such run.
            Conflict: it is neither paused nor interrupted; its rig is busy, not configured any more, or
                configured otherwise, and how.
        """
        run = self.run(run_id)
        if run.status == "interrupted":
            return self._resume_interrupted(run)
        worker = self._worker(run_id, "resumed")
        if not worker.control.holding:
            raise Conflict(f"run {run_id} is not paused")
        worker.control.resume()
        return self.run(run_id)

    def _resume_interrupted(self, run: Run) -> Run:
        settings = self._rigs.get(run.rig or "")
        if settings is None:
            raise Conflict(f"run {run.id} was on rig {run.rig!r}, which is not configured any more")
        task = resumed_task(self.store, run, settings)
        with self._lock:
            self._require_free(settings.name)
            check_transition(run.id, self.run(run.id).status, "queued")  # somebody else may have been first
            self.store.update_run(run.id, status="queued", error=None)
            self._employ(task)
        return self.run(run.id)

    def _worker(self, run_id: str, wish: str) -> Worker:
        with self._lock:
            worker = self._workers.get(run_id)
        if worker is None:
            raise Conflict(f"run {run_id} is {self.run(run_id).status} and cannot be {wish}")
        return worker

    def wait(self, run_id: str, timeout_s: float | None = None) -> Run:
        """The run once it has ended, or as it is after timeout_s."""
        with self._lock:
            worker = self._workers.get(run_id)
        if worker is not None:
            worker.join(timeout_s)
        return self.run(run_id)

    def close(self) -> None:
        """Stops every stage and ends every run as `interrupted`, within five seconds."""
        end = End("interrupted", "the service was stopped during the run")
        with self._lock:
            workers = [] if self._closing else list(self._workers.values())
            self._closing = True
        for worker in workers:
            worker.control.end(end)
        deadlines_s = [worker.clock.now_s() + CLOSE_S for worker in workers]
        for worker, deadline_s in zip(workers, deadlines_s, strict=True):
            worker.join(max(0.0, deadline_s - worker.clock.now_s()))
            worker.give_up(self.store, end)

    def ports(self) -> list[str]:
        """The ports of all rigs."""
        parts = [part for rig in self._rigs.values() for part in (rig.stage, rig.imu)]
        return [part.port for part in parts if part is not None]

    def known_rig(self, name: str | None) -> RigSettings:
        """A rig's settings, those of the first one without a name; Unknown where no such is configured."""
        return self._rig(name)

    def _rig(self, name: str | None) -> RigSettings:
        if name is None:
            return next(iter(self._rigs.values()))
        if name not in self._rigs:
            raise Unknown(f"there is no rig {name!r}; configured: {', '.join(sorted(self._rigs))}")
        return self._rigs[name]
