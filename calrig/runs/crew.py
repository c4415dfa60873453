"""Which worker is on which rig. Locked for no longer than a look, since a stop looks as well."""

from __future__ import annotations

import threading

from calrig.analysis.errors import Conflict
from calrig.runs.worker import Worker


class Crew:
    """The workers of a service. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._workers: dict[str, Worker] = {}
        self._busy: dict[str, str] = {}  # rigs by name, each with its run
        self._unreachable: set[str] = set()
        self._is_closing = False

    def require_free(self, rig_name: str) -> None:
        """Raises Conflict where a rig takes no run now, and why."""
        with self._lock:
            if self._is_closing:
                raise Conflict("the service is shutting down")
            if rig_name in self._busy:
                raise Conflict(f"rig {rig_name!r} is busy with run {self._busy[rig_name]}")

    def take(self, worker: Worker) -> None:
        """Puts a worker on its rig."""
        with self._lock:
            self._workers[worker.run_id] = worker
            self._busy[worker.rig.name] = worker.run_id

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
            workers = [] if self._is_closing else list(self._workers.values())
            self._is_closing = True
        return workers
