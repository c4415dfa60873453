"""Whether a unit is there, before anybody presses Enter: its board is looked at while nobody uses the rig.

Only the board's port is opened: the stage's stays free for a stop at any moment, and nothing moves. It is
looked at for as long as somebody asks, and let go of before a run opens it.
"""

from __future__ import annotations

import logging
import time
from contextlib import closing
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Literal

import numpy as np

from calrig.estimation.angles import wrap_deg
from calrig.instruments.clock import Event
from calrig.instruments.drivers import open_board
from calrig.instruments.errors import InstrumentError
from calrig.instruments.ports import clock_of
from calrig.instruments.types import Board, BoardIdentity, Samples
from calrig.instruments.wanted import require_wanted, while_wanted
from calrig.runs.crew import Crew
from calrig.runs.mounting import Mount, angle_about_deg
from calrig.runs.stage_place import MOST_OFF_DEG
from calrig.settings import BoardSettings, RigSettings
from calrig.store import Store, StoreError

log = logging.getLogger(__name__)

LEASE_S = 6.0
"""How long a board is looked at after somebody has asked for it last, s of the wall's."""
EVERY_S = 0.5
AGAIN_S = 1.0
"""After a board that did not answer, s of its clock."""
LEAVES_S = 2.0
"""How long a run waits for the port, s of its clock: the system may be opening it."""
RATE_HZ = 50
LOOK_S = 0.4
TAKE_S = 0.05
FEWEST = 3
MOVES_G, MOVES_DPS, MOVES_DEG = 0.03, 2.0, 1.0
"""Standard deviation over a look of a unit that somebody has in hand; one at rest has a tenth of it."""
WEIGHT_G = (0.8, 1.2)
"""What a healthy accelerometer feels of gravity."""

State = Literal["looking", "absent", "moving", "askew", "wrong", "there"]


@dataclass(frozen=True, slots=True)
class Sighting:
    """What a look at a rig's board gave.

    Attributes:
        state: `absent` where no board answers, `askew` where gravity contradicts; never `wrong` by itself.
        serial: by the board's own word; "" where it has none, None where no board answers.
        says: the same for a person; of a unit that is there, how gravity finds it.
    """

    state: State
    serial: str | None
    says: str

    def of_unit(self, unit: str) -> Sighting:
        """The same, where that unit is to be there."""
        if self.serial and self.serial != unit:
            return Sighting("wrong", self.serial, f"The board says that it is {self.serial}, not {unit}.")
        if self.state != "there":
            return self
        known = f"{unit} is there, says its board."
        if not self.serial:
            known = f"A unit is there; its board has no serial: see that it is {unit}."
        return replace(self, says=f"{known} {self.says}")


LOOKING = Sighting("looking", None, "Looking for the unit's board.")


class _Unwanted(Exception):  # noqa: N818 (nobody asks any more, or the rig is needed)
    """Ends a look."""


@dataclass
class _Watch:
    rig: RigSettings
    mount: Mount
    until_s: float
    let_go: Event
    over: Event
    seen: Sighting = field(default=LOOKING)


class Sightings:
    """Looks at the boards of idle rigs, a thread for each that somebody asks for. Thread-safe."""

    def __init__(self, store: Store, crew: Crew) -> None:
        self._store, self._crew = store, crew
        self._lock = Lock()
        self._watches: dict[str, _Watch] = {}
        self._is_closing = False

    def look(self, rig: RigSettings, mount: Mount) -> None:
        """Has a rig's board looked at for a while; returns at once.

        Args:
            rig: nothing is done while it is busy.
            mount: how its next unit is to be clamped.
        """
        if rig.imu is None or not self._is_free(rig.name):
            return
        with self._lock:
            watch = self._watches.get(rig.name)
            if watch is not None:
                watch.mount, watch.until_s = mount, time.monotonic() + LEASE_S
                return
            if self._is_closing:
                return
            clock, until_s = clock_of(rig.imu.port), time.monotonic() + LEASE_S
            watch = _Watch(rig, mount, until_s, clock.event(), clock.event())
            self._watches[rig.name] = watch
            clock.thread(lambda: self._watch(watch), f"look at {rig.name}").start()

    def of(self, rig_name: str) -> Sighting | None:
        """What was seen last; None where nobody looks."""
        with self._lock:
            watch = self._watches.get(rig_name)
            return None if watch is None else watch.seen

    def let_go(self, rig_name: str) -> None:
        """Waits until the port of a rig's board is closed; called once the rig is busy."""
        with self._lock:
            watch = self._watches.get(rig_name)
        if watch is not None:
            watch.let_go.set()
            watch.over.wait(LEAVES_S)

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
                    watch.seen = Sighting("absent", None, f"No unit answers: {error}")
                watch.let_go.wait(AGAIN_S)
        except _Unwanted:
            pass
        except Exception:
            log.exception("the board of rig %r cannot be looked at", watch.rig.name)
        finally:
            with self._lock:
                del self._watches[watch.rig.name]
            watch.over.set()

    def _look_on(self, watch: _Watch, settings: BoardSettings) -> None:
        stage_deg = self._left_at(watch.rig.name)
        board = open_board(settings.driver, settings.port, baudrate=settings.baudrate)
        with closing(board), while_wanted(lambda: self._require(watch)):
            while True:
                identity = board.identify()  # again each time: another one may be on the wire
                watch.seen = judged(identity, _samples(board, identity), watch.mount, stage_deg)
                watch.let_go.wait(EVERY_S)
                self._require(watch)

    def _require(self, watch: _Watch) -> None:
        """Raises where the rig is needed, or nobody has asked for a while."""
        is_over = watch.let_go.is_set() or self._is_closing or time.monotonic() > watch.until_s
        if is_over or not self._is_free(watch.rig.name):
            raise _Unwanted


def judged(identity: BoardIdentity, samples: Samples, mount: Mount, stage_deg: float | None) -> Sighting:
    """What a board's word and gravity say of the unit.

    Args:
        identity: of the board.
        samples: of a moment.
        mount: how the unit is to be clamped.
        stage_deg: elevation at which the stage was left; None where that is not known.
    """
    accel_g = samples.accel_g.mean(axis=0)
    if np.isnan(accel_g).any():  # it sends an angle of its own, whose zero may be anywhere
        turns = np.exp(1j * np.radians(samples.angle_deg))
        off_deg = np.degrees(np.angle(turns / turns.mean()))
        own_deg = float(np.degrees(np.angle(turns.mean())))
        return _at(identity, own_deg, "its own reckoning", moves=off_deg.std() > MOVES_DEG)
    weight_g = float(np.linalg.norm(accel_g))
    spread_dps = float(np.nan_to_num(samples.gyro_dps.std(axis=0)).max())
    moves = samples.accel_g.std(axis=0).max() > MOVES_G or spread_dps > MOVES_DPS
    angle_deg = angle_about_deg(mount.axis, accel_g)
    if moves:
        return _at(identity, angle_deg, "gravity", moves=True)
    if not WEIGHT_G[0] < weight_g < WEIGHT_G[1]:
        return Sighting(
            "askew",
            identity.serial,
            f"Its accelerometer feels {weight_g:.2f} g at rest, not 1 g: it is broken, or its range another.",
        )
    agreeing_deg = mount.sense * angle_deg - mount.deg
    if refusal := mount.refusal(agreeing_deg, angle_deg, accel_g):
        return Sighting("askew", identity.serial, f"{refusal[0].upper()}{refusal[1:]}.")
    if stage_deg is not None and abs(mount.clamped_at(stage_deg, angle_deg) - mount.deg) > MOST_OFF_DEG:
        return Sighting(
            "askew",
            identity.serial,
            f"Gravity finds the unit at {angle_deg:.1f}°. Clamped as asked it would be at "
            f"{wrap_deg(mount.felt_at(stage_deg)):.1f}°, if the stage still stands at {stage_deg:.1f}° where "
            "the last run left it.",
        )
    return _at(identity, angle_deg, "gravity", moves=False)


def _at(identity: BoardIdentity, angle_deg: float, by: str, *, moves: bool) -> Sighting:
    if moves:
        return Sighting("moving", identity.serial, "The unit is being moved.")
    return Sighting("there", identity.serial, f"It sits still, by {by} at {angle_deg:z.1f}°.")


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
