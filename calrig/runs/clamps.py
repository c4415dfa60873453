"""A rig's clamp, where it has one: it turns the unit because a person asks, and never because a run does."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import closing
from typing import TypeVar

from calrig.analysis.errors import Conflict
from calrig.instruments.clamps.index import CLAMPS
from calrig.instruments.errors import InstrumentError
from calrig.instruments.ports import clock_of
from calrig.model.plan import MountAxis
from calrig.runs.crew import WorkerRegistry
from calrig.runs.single_flight import SharedTask, SingleFlight
from calrig.settings import ClampSettings, RigSettings

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
