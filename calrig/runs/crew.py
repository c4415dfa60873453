"""Registry of what occupies each rig: the worker of a run, or its clamp while it rotates the unit.

The lock is held only briefly, because stop requests take it too. A clamp moves only by a user's request,
never as part of a run.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import TypeVar

from calrig.analysis.errors import Conflict
from calrig.instruments.errors import InstrumentError
from calrig.instruments.index_clamp import CLAMPS
from calrig.instruments.ports import clock_of
from calrig.model.plan import MountAxis
from calrig.runs.single_flight import SharedTask, SingleFlight
from calrig.runs.worker import Worker
from calrig.settings import ClampSettings, RigSettings


class WorkerRegistry:
    """The workers of a service. Thread-safe. Once it `is_closing`, nobody is taken any more."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._workers: dict[str, Worker] = {}
        self._busy: dict[str, str] = {}  # rigs by name, each with its run
        self._unreachable: set[str] = set()
        self._called_off: set[str] = set()
        self.is_closing = False

    def require_free(self, rig_name: str, run_id: str | None = None) -> None:
        """Raises Conflict where a rig takes no run now, or not this one, and why."""
        with self._lock:
            if self.is_closing:
                raise Conflict("the service is shutting down")
            if self._busy.get(rig_name, run_id) != run_id:
                raise Conflict(f"rig {rig_name!r} is busy with run {self._busy[rig_name]}")

    def is_free(self, rig_name: str) -> bool:
        """Whether no run is on a rig, and none is about to be."""
        return rig_name not in self.look()[0]

    @contextmanager
    def keeping(self, rig_name: str, run_id: str) -> Iterator[bool]:
        """Keeps a rig for a run that is about to begin, and no longer; gives whether the rig was free."""
        with self._lock:
            is_free = not self.is_closing and rig_name not in self._busy
            if is_free:
                self._busy[rig_name] = run_id
        try:
            yield is_free
        finally:
            with self._lock:
                if is_free:
                    self._called_off.discard(run_id)
                    if self._busy.get(rig_name) == run_id and run_id not in self._workers:
                        del self._busy[rig_name]

    def call_off(self, rig_name: str) -> None:
        """Whatever a rig is kept for is not to move it any more."""
        with self._lock:
            run_id = self._busy.get(rig_name)
            if run_id is not None and run_id not in self._workers:
                self._called_off.add(run_id)

    def take(self, worker: Worker) -> bool:
        """Puts a worker on its rig; returns whether the run has been called off meanwhile."""
        with self._lock:
            self._workers[worker.run_id] = worker
            self._busy[worker.rig.name] = worker.run_id
            return worker.run_id in self._called_off

    def left_rig(self, worker: Worker) -> None:
        """The worker has closed its rig's ports."""
        with self._lock:
            del self._busy[worker.rig.name]
            if worker.reached_rig:
                self._unreachable.discard(worker.rig.name)
            elif worker.reached_rig is False:
                self._unreachable.add(worker.rig.name)

    def ended(self, worker: Worker) -> None:
        """The worker has written its run's end down."""
        with self._lock:
            del self._workers[worker.run_id]

    def of_run(self, run_id: str) -> Worker | None:
        """Who carries a run out."""
        with self._lock:
            return self._workers.get(run_id)

    def on(self, rig_name: str) -> Worker | None:
        """Who is on a rig."""
        with self._lock:
            return self._workers.get(self._busy.get(rig_name, ""))

    def look(self) -> tuple[dict[str, str], set[str]]:
        """The rigs that are busy, each with its run, and those that the last run did not reach."""
        with self._lock:
            return dict(self._busy), set(self._unreachable)

    def close(self) -> list[Worker]:
        """Takes nobody any more; returns who is there, the first time."""
        with self._lock:
            workers = [] if self.is_closing else list(self._workers.values())
            self.is_closing = True
        return workers


T = TypeVar("T")


class Clamps:
    """The clamps of a service's rigs. Thread-safe. `still` is called with a rig whose clamp has turned."""

    def __init__(self, crew: WorkerRegistry, still: Callable[[str], None]) -> None:
        self._crew, self._still = crew, still
        self._errands = SingleFlight()
        self._lock = threading.Lock()
        self._turning: set[str] = set()

    def require_still(self, rig_name: str) -> None:
        """Raises Conflict while the unit is being turned."""
        with self._lock:
            if rig_name in self._turning:
                raise Conflict(f"the clamp of rig {rig_name!r} is turning the unit: wait until it sits")

    def turn(
        self, rig: RigSettings, mount_deg: float, axis: MountAxis, answer: Callable[[], T]
    ) -> SharedTask[T]:
        """Turns the unit of a rig, on which no run is, or one that waits for just that.

        Args:
            rig: the rig.
            mount_deg: the angle at which the unit is to sit.
            axis: which of its axes along the stage's.
            answer: what came of it, once it sits.

        Raises:
            Conflict: the rig has no clamp, or a run is on it that does not wait; raised by the errand: the
                clamp refuses.
        """
        clamp = rig.clamp
        if clamp is None:
            raise Conflict(f"rig {rig.name!r} has no clamp of its own: turn the unit by hand")
        run_id = self._crew.look()[0].get(rig.name)
        worker = self._crew.on(rig.name)
        if run_id is not None and (worker is None or not worker.control.is_waiting):
            raise Conflict(f"run {run_id} is on rig {rig.name!r} and does not wait for the unit to be turned")

        def turned() -> T:
            try:
                _turn(clamp, mount_deg, axis)
            except InstrumentError as error:
                raise Conflict(f"rig {rig.name!r}: {error}") from error
            finally:
                with self._lock:
                    self._turning.discard(rig.name)
                self._still(rig.name)
            return answer()

        with self._lock:
            if rig.name in self._turning:
                raise Conflict(f"the clamp of rig {rig.name!r} is turning the unit already")
            self._turning.add(rig.name)
        return self._errands.share(("clamp", rig.name), clock_of(clamp.port), turned)


def _turn(clamp: ClampSettings, mount_deg: float, axis: MountAxis) -> None:
    with closing(CLAMPS[clamp.driver].open(clamp.port, baudrate=clamp.baudrate)) as head:
        head.identify()
        head.turn_to(mount_deg, axis)
