"""Tells those who watch a run that its event log has grown. The log itself is the truth."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Bus:
    """Wake-up calls per run, from run threads to any number of watchers."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._watchers: dict[str, list[Callable[[], None]]] = {}
        self._of_all: list[Callable[[], None]] = []
        self._hearing: list[Callable[[str], None]] = []

    def subscribe_to_all(self, wake: Callable[[], None]) -> None:
        """Has `wake` called after each commit of new events of any run."""
        with self._lock:
            self._of_all.append(wake)

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
            watchers = [*self._watchers.get(run_id, ()), *self._of_all]
            hearing = list(self._hearing)
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
