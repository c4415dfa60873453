"""Runs begin: one at a time on each rig, at once or when those that were asked for before have ended."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path

from calrig.analysis.errors import Conflict
from calrig.analysis.issuing import Issuer
from calrig.runs.bus import Bus
from calrig.runs.clamps import Clamps
from calrig.runs.crew import Crew
from calrig.runs.meter import Meter
from calrig.runs.new_run import NewRun
from calrig.runs.planned import planned_poses
from calrig.runs.queue import RunQueue
from calrig.runs.reachable import require_reachable
from calrig.runs.references import require_in_date
from calrig.runs.resume import waiting_task
from calrig.runs.sightings import Sightings
from calrig.runs.stopping import BY_REQUEST
from calrig.runs.task import Task
from calrig.runs.worker import Worker
from calrig.settings import RigSettings
from calrig.store import Run, Store
from calrig.store.records import Document


class Starts:
    """Has a service's runs begin. Thread-safe.

    Attributes:
        lock: held while the store is told of a run that takes a rig.
        queue: of runs that wait for a rig.
        clamps: of the rigs; while one turns, no run begins there.
        sightings: of the units on idle rigs, which end where a run begins and leave it the open port.

    Args:
        store: where runs are kept.
        rigs: those there are.
        crew: which workers are on them.
        bus, meter: hear of the runs.
        issuer: makes drafts of completed calibrations.
        maps: as of `RunService`.
        record: folder for transcripts of every byte on the rigs' wires; None for none.
    """

    def __init__(
        self,
        store: Store,
        rigs: Mapping[str, RigSettings],
        crew: Crew,
        bus: Bus,
        meter: Meter,
        issuer: Issuer,
        maps: Mapping[str, Document],
        record: Path | None,
    ) -> None:
        self._store, self._rigs, self._crew, self._bus, self._meter = store, rigs, crew, bus, meter
        self._issuer, self._maps, self._record = issuer, maps, record
        self.lock = threading.Lock()
        self.queue = RunQueue(store, bus, meter, self.lock, self._require_ready, self._begin_waiting)
        self.clamps = Clamps(crew, self.queue.next)
        self.sightings = Sightings(store, crew)

    def begin(self, settings: RigSettings, wanted: NewRun, *, waits: bool) -> Run:
        """Begins a run on a rig, which is free or kept for it, or has it wait; as of `RunService.begin`."""
        plan = wanted.plan
        require_in_date(settings)
        planned = planned_poses(plan, settings)
        wanted = wanted.as_of_now(self._store, settings.name, self._maps)
        require_reachable(plan, settings, wanted.unit, self._store, wanted.origin.get("stage_map"))
        with self.lock:
            self.clamps.require_still(settings.name)
            try:
                self._crew.require_free(settings.name, wanted.run_id)
                self.queue.require_nobody(settings.name)
            except Conflict:
                if not waits or self._crew.is_closing:
                    raise
                return self._wait_in_turn(settings.name, wanted, len(planned))
            run = wanted.keep(self._store, settings.name, len(planned))
            task = Task(
                run,
                settings,
                plan,
                planned,
                wanted.follow_up,
                wanted.verifies,
                stage_at_deg=wanted.stage_at_deg,
            )
            self.employ(task)
        return run

    def employ(self, task: Task) -> None:
        """Starts a worker; called under `lock`."""
        left = self._crew.left_rig
        worker = Worker(
            task, self._store, self._issuer, self._bus, self._meter, left, self._ended, self._record
        )
        if self._crew.take(worker):
            worker.control.end(BY_REQUEST)
        worker.start(self.sightings.let_go(worker.rig.name))

    def _wait_in_turn(self, rig_name: str, wanted: NewRun, n_poses: int) -> Run:
        if wanted.stage_at_deg is not None:
            raise Conflict("where the stage stands cannot be said of a run that waits: others move it before")
        run = wanted.keep(self._store, rig_name, n_poses)
        self.queue.add(run)
        return run

    def _begin_waiting(self, run: Run) -> None:
        """Begins a run whose turn has come."""
        settings = self._rigs.get(run.rig or "")
        if settings is None:
            raise Conflict(f"rig {run.rig!r} is not configured any more")
        self.employ(waiting_task(self._store, run, settings, self._maps))

    def _require_ready(self, rig_name: str) -> None:
        self._crew.require_free(rig_name)
        self.clamps.require_still(rig_name)

    def _ended(self, worker: Worker) -> None:
        self._crew.ended(worker)
        self.queue.next(worker.rig.name)
