"""Queue of the runs that wait for a rig, and the recovery after a program's death.

Each queued run starts when its rig is free, in the order of the requests. Runs that an earlier process left
queued are held: after a power cut nothing moves until a user resumes them. Every stage that a dead program
may have left moving is stopped before its runs are marked.
"""

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from calrig.analysis.errors import Conflict, RunsError
from calrig.instruments.errors import InstrumentError
from calrig.instruments.standstill import CUT
from calrig.model.run import UNTIL_GO
from calrig.runs.recorder import Bus, ServiceMetrics
from calrig.runs.rig import is_lost_since, resumed_by, stop_stage
from calrig.runs.stopping import STOPPED
from calrig.settings import RigSettings
from calrig.store import Run, RunChanges, Store, StoreError
from calrig.store.trail import Act

log = logging.getLogger(__name__)

HELD = f"the service was started anew while this run waited its turn: {UNTIL_GO}"


class RunQueue:
    """Which runs wait for which rig. Thread-safe; nothing in it waits for a rig or the store but `next`.

    Args:
        bus: tells those who watch a run that ends without having begun.
        beginning: is held while a run begins; whoever calls `next` must not hold it.
        require_ready: raises Conflict where a rig takes no run now.
        begin: begins a stored run, while `beginning` is held.
    """

    def __init__(
        self,
        store: Store,
        bus: Bus,
        meter: ServiceMetrics,
        beginning: threading.Lock,
        require_ready: Callable[[str], None],
        begin: Callable[[Run], None],
    ) -> None:
        self._store, self._bus, self._meter, self._beginning = store, bus, meter, beginning
        self._require_ready, self._begin = require_ready, begin
        self._lock = threading.Lock()
        self._waiting: dict[str, list[str]] = {}  # by rig, the first to begin first
        self._held: dict[str, str] = {}  # rigs by run
        for run in store.runs.unfinished():
            if waits_its_turn(run) and run.rig is not None:
                self._held[run.id] = run.rig

    def add(self, run: Run) -> None:
        """Has a run wait for its rig."""
        with self._lock:
            self._waiting.setdefault(run.rig or "", []).append(run.id)

    def require_nobody(self, rig_name: str) -> None:
        """Raises Conflict where a run waits for a rig, before which no other is begun."""
        with self._lock:
            waiting = self._waiting.get(rig_name)
        if waiting:
            raise Conflict(
                f'rig {rig_name!r} is busy: run {waiting[0]} is next; ask with "queue": true to wait'
            )

    def go(self, run_id: str, who: str | None = None) -> bool:
        """Has a run that is held wait its turn again; returns whether it was."""
        with self._lock:
            rig_name = self._held.pop(run_id, None)
            if rig_name is not None:
                self._waiting.setdefault(rig_name, []).append(run_id)
        if rig_name is None:
            return False
        self._store.runs.update(run_id, error=None, asked=Act("resumed", who))
        self.next(rig_name)
        return True

    def take_out(self, run_id: str, who: str | None = None) -> bool:
        """Aborts a run that waits or is held; returns whether it did either. Called under `beginning`."""
        with self._lock:
            found = self._held.pop(run_id, None) is not None
            for waiting in self._waiting.values():
                if run_id in waiting:
                    waiting.remove(run_id)
                    found = True
        if found:
            self._end(run_id, {"status": "aborted", "error": None}, Act("aborted", who))
        return found

    def call_off(self, rig_name: str, who: str | None = None) -> Callable[[], None]:
        """Nothing that waits for a rig is to move it any more; gives what tells the store so."""
        with self._lock:
            off = [
                *self._waiting.pop(rig_name, ()),
                *(run for run, rig in self._held.items() if rig == rig_name),
            ]
            for run_id in off:
                self._held.pop(run_id, None)

        def tell() -> None:
            for run_id in off:
                try:
                    asked = Act("aborted", who)
                    self._end(run_id, {"status": "aborted", "error": STOPPED}, asked)
                except StoreError as error:  # of a stop that was made, the store's trouble makes no failure
                    log.error("run %s is not told of as aborted; it does not begin: %s", run_id, error)

        return tell

    def next(self, rig_name: str) -> None:
        """Begins the run that waits longest for a rig, where the rig is free; raises nothing."""
        with self._beginning:
            while (run_id := self._first(rig_name)) is not None:
                try:
                    self._require_ready(rig_name)
                except Conflict:
                    return
                if self._has_begun(rig_name, run_id):
                    return

    def _has_begun(self, rig_name: str, run_id: str) -> bool:
        try:
            run = self._store.runs.get(run_id)
            if not self._remove(rig_name, run_id) or run is None:
                return False  # called off meanwhile
            self._begin(run)
        except RunsError as error:
            self._fail(rig_name, run_id, str(error))
            return False
        except StoreError as error:
            log.error("run %s waits until somebody says Go: %s", run_id, error)
            self._hold(rig_name, run_id)
            return False
        return True

    def _fail(self, rig_name: str, run_id: str, why: str) -> None:
        try:
            self._end(run_id, {"status": "failed", "error": why})
        except StoreError as error:
            log.error("run %s cannot begin (%s) and the store cannot be told: %s", run_id, why, error)
            self._hold(rig_name, run_id)

    def _end(self, run_id: str, changes: RunChanges, asked: Act | None = None) -> None:
        run = self._store.runs.update(run_id, asked=asked, **changes)
        self._meter.of_run(run.rig or "").ended(run.status)
        self._bus.wake(run_id)

    def _first(self, rig_name: str) -> str | None:
        with self._lock:
            return next(iter(self._waiting.get(rig_name, ())), None)

    def _remove(self, rig_name: str, run_id: str) -> bool:
        with self._lock:
            waiting = self._waiting.get(rig_name, [])
            found = run_id in waiting
            if found:
                waiting.remove(run_id)
            return found

    def _hold(self, rig_name: str, run_id: str) -> None:
        self._remove(rig_name, run_id)
        with self._lock:
            self._held[run_id] = rig_name


def waits_its_turn(run: Run) -> bool:
    """Whether a stored run has never moved anything, nor opened a port: it is queued and never began."""
    return run.status == "queued" and run.started_at is None


DIED = "the program that carried it out ended before the run did; the run can be resumed"
STAGES_AT_ONCE = 8


def stop_stages(names: Sequence[str], rigs: Mapping[str, RigSettings]) -> dict[str, str]:
    """Tells the stages of rigs that a dead program used to stop, side by side, and sees that they stand.

    Returns:
        What a person must know, by rig, where a stage could not be told.
    """
    if not names:
        return {}
    with ThreadPoolExecutor(min(len(names), STAGES_AT_ONCE)) as stages:
        said = stages.map(lambda name: _stopped(name, rigs.get(name)), names)
        return {name: trouble for name, trouble in zip(names, said, strict=True) if trouble is not None}


def mark_interrupted(store: Store, troubles: Mapping[str, str], *, keeps_queue: bool = False) -> list[str]:
    """Marks the runs that a dead program left unfinished as `interrupted`; returns their ids.

    For a writer that has just opened the store: then no living program carries any of them out. With
    `keeps_queue` those that only waited their turn stay `queued`, and say what they wait for now.
    """
    left = []
    for run in store.runs.unfinished():
        if keeps_queue and waits_its_turn(run):
            store.runs.update(run.id, error=HELD)
            continue
        left.append(run)
        trouble = troubles.get(run.rig or "")
        log.warning("run %s was interrupted: %s", run.id, trouble or "its stage stands")
        said = [DIED, *([trouble] if trouble else []), *_where_it_stands(store, run)]
        store.runs.update(run.id, status="interrupted", error="; ".join(said))
    return [run.id for run in left]


def _where_it_stands(store: Store, run: Run) -> list[str]:
    """What resuming a run needs to be told whose stage has no homing and was on its way."""
    if not is_lost_since(store, run):
        return []
    return [f"its stage has no homing, and where it stands is not known: {resumed_by(run.id)}"]


def _stopped(name: str, rig: RigSettings | None) -> str | None:
    """Stops the stage of a rig; what a person must know where that cannot be done."""
    if rig is None:
        return f"its rig {name!r} is not configured any more: see for yourself that the stage stands"
    if rig.simulated is not None:
        return None  # its devices went with the program
    try:
        stop_stage(rig)
    except InstrumentError as error:
        advice = "" if CUT in str(error) else f", or {CUT}"
        return f"its stage could not be told to stop ({error}): see that it stands{advice}"
    return None
