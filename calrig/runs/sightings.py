"""Whether a unit is there, before anybody presses Enter: its board is looked at while nobody uses the rig.

Only the board's port is opened: the stage's stays free for a stop at any moment, and nothing moves. It is
looked at for as long as somebody asks; a run that begins goes on with the open port, where the board may.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field
from threading import Lock

from calrig.instruments.clock import Event
from calrig.instruments.drivers import may_stay_open, open_board
from calrig.instruments.errors import InstrumentError
from calrig.instruments.ports import clock_of
from calrig.instruments.transcript import taped
from calrig.instruments.types import Board, BoardIdentity, Samples
from calrig.instruments.wanted import require_wanted, while_wanted
from calrig.runs.crew import Crew
from calrig.runs.left_open import LeftOpen
from calrig.runs.look import Look, felt
from calrig.settings import BoardSettings, RigSettings
from calrig.store import Store, StoreError

log = logging.getLogger(__name__)

LEASE_S = 6.0
"""How long a board is looked at after somebody has asked for it last, s of the wall's."""
EVERY_S = 0.5
AGAIN_S = 1.0
"""After a board that did not answer, s of its clock."""
LEAVES_S = 4.0
"""How long a run waits for the board, s of its clock: it may not hear that it is to stop, which takes 3 s."""
RATE_HZ = 50
LOOK_S = 0.4
TAKE_S = 0.05
FEWEST = 3


class _Unwanted(Exception):  # noqa: N818 (nobody asks any more, or the rig is needed)
    """Ends a look."""


@dataclass
class _Watch:
    rig: RigSettings
    until_s: float
    let_go: Event
    over: Event
    seen: Look = field(default=Look())
    left_open: LeftOpen | None = None
    is_given_up: bool = False


class Sightings:
    """Looks at the boards of idle rigs, a thread for each that somebody asks for. Thread-safe."""

    def __init__(self, store: Store, crew: Crew) -> None:
        self._store, self._crew = store, crew
        self._lock = Lock()
        self._watches: dict[str, _Watch] = {}
        self._is_closing = False

    def look(self, rig: RigSettings) -> None:
        """Has a rig's board looked at for a while; returns at once. Nothing is done while it is busy."""
        if rig.imu is None or not self._is_free(rig.name):
            return
        with self._lock:
            watch = self._watches.get(rig.name)
            if watch is not None:
                watch.until_s = time.monotonic() + LEASE_S
                return
            if self._is_closing:
                return
            clock, until_s = clock_of(rig.imu.port), time.monotonic() + LEASE_S
            watch = _Watch(rig, until_s, clock.event(), clock.event())
            self._watches[rig.name] = watch
            clock.thread(lambda: self._watch(watch), f"look at {rig.name}").start()

    def looks(self) -> dict[str, Look]:
        """What was seen last on each rig that is looked at."""
        with self._lock:
            return {name: watch.seen for name, watch in self._watches.items()}

    def let_go(self, rig_name: str) -> LeftOpen | None:
        """Ends the look at a rig's board, for a run that has taken the rig.

        Returns:
            The board, where its port is still open; None where the run is to open it.
        """
        with self._lock:
            watch = self._watches.get(rig_name)
        if watch is None:
            return None
        watch.let_go.set()
        watch.over.wait(LEAVES_S)
        with self._lock:
            watch.is_given_up = not watch.over.is_set()
            return None if watch.is_given_up else watch.left_open

    def close(self) -> None:
        """Looks at nothing any more."""
        with self._lock:
            self._is_closing, watches = True, list(self._watches.values())
        for watch in watches:
            watch.let_go.set()
        for watch in watches:
            watch.over.wait(LEAVES_S)

    def _is_free(self, rig_name: str) -> bool:
        return rig_name not in self._crew.look()[0]

    def _left_at(self, rig_name: str) -> float | None:
        """The elevation at which the last run left the stage; None where that is not known."""
        try:
            runs, _ = self._store.runs(rig=rig_name, limit=1)
            if not runs or runs[0].status != "completed" or "stage" not in runs[0].provenance:
                return None  # stopped on its way, or imported
            poses = self._store.poses(runs[0].id)
        except StoreError:
            return None
        return poses[-1].pose.stage_deg if poses else None

    def _watch(self, watch: _Watch) -> None:
        """Looks until nobody wants it."""
        assert watch.rig.imu is not None  # noqa: S101 (as asked for)
        try:
            while True:
                self._require(watch)
                try:
                    self._look_on(watch, watch.rig.imu)
                except InstrumentError as error:
                    watch.seen = Look(trouble=str(error))
                watch.let_go.wait(AGAIN_S)
        except _Unwanted:
            pass
        except Exception:
            log.exception("the board of rig %r cannot be looked at", watch.rig.name)
        finally:
            with self._lock:
                del self._watches[watch.rig.name]
                watch.over.set()
            if watch.is_given_up and watch.left_open is not None:
                watch.left_open.board.close()

    def _look_on(self, watch: _Watch, settings: BoardSettings) -> None:
        stage_deg, is_known = self._left_at(watch.rig.name), False
        with taped() as tapes:
            board = open_board(settings.driver, settings.port, baudrate=settings.baudrate)
        try:
            with while_wanted(lambda: self._require(watch)):
                while True:
                    identity = board.identify()  # again each time: another one may be on the wire
                    is_known = True
                    watch.seen = felt(identity, _samples(board, identity), stage_deg)
                    watch.let_go.wait(EVERY_S)
                    self._require(watch)
        except _Unwanted:
            if may_stay_open(settings.driver) and self._is_for_a_run(watch):
                if is_known:
                    board.stop()
                watch.left_open = LeftOpen(board, tapes.all)
            raise
        finally:
            if watch.left_open is None:
                board.close()

    def _is_for_a_run(self, watch: _Watch) -> bool:
        """Whether a look has ended because a run takes the rig, which may be about to say so."""
        is_taken = not self._is_free(watch.rig.name) and watch.let_go.wait(LEAVES_S)
        return is_taken and not self._is_closing

    def _require(self, watch: _Watch) -> None:
        """Raises where the rig is needed, or nobody has asked for a while."""
        is_over = watch.let_go.is_set() or self._is_closing or time.monotonic() > watch.until_s
        if is_over or not self._is_free(watch.rig.name):
            raise _Unwanted


def _samples(board: Board, identity: BoardIdentity) -> Samples:
    """Those of a moment."""
    rate_hz = identity.rate_hz or min(RATE_HZ, identity.max_rate_hz or RATE_HZ)
    wanted, blocks, count = max(FEWEST, round(LOOK_S * rate_hz)), [], 0
    board.start(round(rate_hz))
    while count < wanted:
        require_wanted()
        block = board.take(TAKE_S)
        count += len(block)
        blocks.append(block)
    board.stop()
    return Samples.join(blocks)
