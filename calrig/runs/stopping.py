"""Stop service: stop a rig's stage at once and report whether standstill was confirmed."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from calrig.analysis.errors import Conflict
from calrig.instruments.clock import WALL, Clock, Event
from calrig.instruments.errors import InstrumentError
from calrig.instruments.ports import clock_of
from calrig.instruments.standstill import CUT
from calrig.runs.control import End
from calrig.runs.crew import WorkerRegistry
from calrig.runs.rig import stop_stage
from calrig.runs.single_flight import SharedTask, SingleFlight
from calrig.runs.worker import Worker
from calrig.settings import RigSettings

SEEN_S = 9.0
"""How long a run that was told to end may take to see its stage stand, s of the rig's clock."""
OPENS_S = 2.0
"""How long a port may take to open until who asked hears that the stage could not be told, likewise."""
STOPPED = "the stage was stopped by request"
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class StopRequest:
    """A stage that nobody uses is being told; `opened` once its port has, or has not for a reason."""

    opened: Event
    errand: SharedTask[None]


class StopService:
    """Stops of rigs and runs, each in a thread of its own: no rig waits for another, or for anything else."""

    def __init__(self, crew: WorkerRegistry) -> None:
        self._crew = crew
        self._errands = SingleFlight()
        self._lock = threading.Lock()
        self._telling: dict[str, StopRequest] = {}  # by rig: a port that does not open is waited for once

    def stop(self, rig: RigSettings, answer: Callable[[], T], who: str | None = None) -> SharedTask[T]:
        """Stops a rig's stage, whatever runs; who asks while it is being told shares that telling.

        Args:
            rig: the rig.
            answer: what came of it, once the stage was seen to stand.
            who: asks; entered in the trail with the end of the run that this aborts, if any.
        """
        end = End("aborted", STOPPED, who)

        def stopped() -> T:
            if not self._stop_run_on(rig, end):
                self._stop_idle(rig, end)
            return answer()

        worker = self._crew.on(rig.name)  # a run that began since has to be told anew
        key = "stop", rig.name, None if worker is None else worker.run_id
        return self._errands.share(key, _clock_of(rig), stopped)

    def abort(self, worker: Worker, aborted: Callable[[], T]) -> SharedTask[T]:
        """Aborts a run; who asks meanwhile shares that."""
        return self._errands.share(("abort", worker.run_id), worker.clock, aborted)

    def stop_run(self, worker: Worker, end: End) -> None:
        """Has a run end and its stage stop, and waits until the stage was seen to stand.

        Raises:
            Conflict: it is not known to; says why and what to do.
        """
        if not _told(worker, end) and self._crew.on(worker.rig.name) is None:
            self._stop_idle(worker.rig, end)

    def _stop_run_on(self, rig: RigSettings, end: End) -> bool:
        worker = self._crew.on(rig.name)
        return worker is not None and _told(worker, end)

    def _stop_idle(self, rig: RigSettings, end: End) -> None:
        telling = self._tell(rig)
        telling.opened.wait(OPENS_S)
        if not telling.opened.is_set():
            raise Conflict(_not_open(rig))
        try:
            telling.errand.result()
        except InstrumentError as error:
            if self._stop_run_on(rig, End("aborted", STOPPED, end.who)):  # a run may just have taken the port
                return
            advice = "" if CUT in str(error) else f": {CUT}"
            raise Conflict(f"rig {rig.name!r}: stop not confirmed ({error}){advice}") from error

    def _tell(self, rig: RigSettings) -> StopRequest:
        """Has a thread tell the stage, which goes on though nobody waits for it any more."""
        clock = _clock_of(rig)
        with self._lock:
            telling = self._telling.get(rig.name)
            if telling is None or telling.errand.future.done():
                telling = self._telling[rig.name] = StopRequest(clock.event(), SharedTask(clock))
                work = partial(stop_stage, rig, telling.opened.set)
                carry_out = partial(telling.errand.carry_out, work)
                clock.thread(carry_out, f"stop of {rig.name}").start()
            return telling


def _clock_of(rig: RigSettings) -> Clock:
    return WALL if rig.stage is None else clock_of(rig.stage.port)


def _not_open(rig: RigSettings, receiver: str = "") -> str:
    port = "" if rig.stage is None else f" {rig.stage.port}"
    return (
        f"rig {rig.name!r}: stop not sent{receiver}, because its port{port} did not open within "
        f"{OPENS_S:g} s. calrig sends it once the port opens; do not wait: {CUT}"
    )


def _told(worker: Worker, end: End) -> bool:
    """Has a run end, and waits until it has looked at its stage; returns whether it did.

    A run that never reached its stage, or had left it when it was told, does not look.

    Raises:
        Conflict: the stage is not known to stand.
    """
    worker.control.end(end)
    if not worker.control.reached(OPENS_S):
        raise Conflict(_not_open(worker.rig, f" to run {worker.run_id}"))
    left = worker.control.left(SEEN_S)
    if left is None:
        raise Conflict(
            f"rig {worker.rig.name!r}: stop sent, but run {worker.run_id} did not confirm standstill within "
            f"{SEEN_S:g} s: {CUT}"
        )
    if left.trouble is not None:
        raise Conflict(f"rig {worker.rig.name!r}: {left.trouble}")
    return left.seen
