"""Check which unit a rig's board reports, before a run starts.

Only the board's port is opened: the stage's port stays free for a stop, and nothing moves. A board is checked
as long as requests for it arrive; a run that starts takes over the open port if the board allows it. Check
and evaluation are separate, because a bench checks and its centre evaluates.
"""

import logging
import time
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Literal, Self

import numpy as np

from calrig.estimation.angles import wrap_deg
from calrig.instruments.cancellation import cancel_scope, raise_if_cancelled
from calrig.instruments.clock import Event
from calrig.instruments.drivers import may_stay_open, open_board
from calrig.instruments.errors import InstrumentError
from calrig.instruments.ports import clock_of
from calrig.instruments.transcript import taped
from calrig.instruments.types import Board, BoardIdentity, Samples
from calrig.runs.assignment import OpenBoardHandover
from calrig.runs.crew import WorkerRegistry
from calrig.runs.mounting import Mounting, angle_about_deg
from calrig.runs.rig import MOST_OFF_DEG
from calrig.settings import BoardSettings, RigSettings
from calrig.store import Store, StoreError

MOVES_G, MOVES_DPS, MOVES_DEG = 0.03, 2.0, 1.0
"""Standard deviation over a look of a unit that somebody has in hand; one at rest has a tenth of it."""
WEIGHT_G = (0.8, 1.2)
"""Gravity as a sound accelerometer measures it."""

State = Literal["looking", "absent", "moving", "askew", "wrong", "there"]


@dataclass(frozen=True, slots=True)
class PresenceStatus:
    """What is seen of a unit on a rig.

    Attributes:
        state: `absent` where no board answers, `askew` where gravity contradicts; never `wrong` by itself.
        serial: by the board's own word; "" where it has none, None where no board answers.
        says: the same for a person; of a unit that is there, how gravity finds it.
    """

    state: State
    serial: str | None
    says: str

    def of_unit(self, unit: str) -> Self:
        """The same, where that unit is to be there."""
        if self.serial and self.serial != unit:
            says = f"The board reports serial number {self.serial}, not {unit}."
            return replace(self, state="wrong", says=says)
        if self.state != "there":
            return self
        known = f"Board of {unit} detected."
        if not self.serial:
            known = f"Board detected, without serial number. Check that the unit is {unit}."
        return replace(self, says=f"{known} {self.says}")


@dataclass(frozen=True, slots=True)
class BoardCheck:
    """What the last look at a rig's board gave. Without a serial or a trouble: nothing yet.

    Attributes:
        serial: by the board's own word; "" where it has none, None where no board has answered.
        trouble: why none answers.
        accel_g: mean specific force; None of a board that sends an angle of its own.
        own_deg: that angle, whose zero may be anywhere.
        stage_deg: elevation at which the last run left the stage; None where that is not known.
    """

    serial: str | None = None
    trouble: str | None = None
    accel_g: tuple[float, float, float] | None = None
    own_deg: float | None = None
    moves: bool = False
    stage_deg: float | None = None

    def sighting(self, mount: Mounting) -> PresenceStatus:
        """What it says of a unit that is to be clamped so."""
        if self.serial is None:
            if self.trouble is None:
                return PresenceStatus("looking", None, "Looking for the unit's board.")
            return PresenceStatus("absent", None, f"No unit answers: {self.trouble}")
        if self.moves:
            return PresenceStatus("moving", self.serial, "The unit is being moved.")
        if self.accel_g is None:
            return self._still("the board's own angle", self.own_deg or 0.0)
        return self._by_gravity(np.array(self.accel_g), mount)

    def _by_gravity(self, accel_g: np.typing.NDArray[np.float64], mount: Mounting) -> PresenceStatus:
        weight_g, angle_deg = float(np.linalg.norm(accel_g)), angle_about_deg(mount.axis, accel_g)
        if not WEIGHT_G[0] < weight_g < WEIGHT_G[1]:
            return self._askew(
                f"Its accelerometer measures {weight_g:.2f} g at rest instead of 1 g: it is faulty, or its "
                "full-scale range is set differently."
            )
        agreeing_deg = mount.sense * angle_deg - mount.deg
        if refusal := mount.refusal(agreeing_deg, angle_deg, accel_g):
            return self._askew(f"{refusal[0].upper()}{refusal[1:]}.")
        stage_deg = self.stage_deg
        if stage_deg is not None and abs(mount.clamped_at(stage_deg, angle_deg) - mount.deg) > MOST_OFF_DEG:
            return self._askew(
                f"Gravity finds the unit at {angle_deg:.1f}°. Clamped as asked it would be at "
                f"{wrap_deg(mount.felt_at(stage_deg)):.1f}°, if the stage still stands at {stage_deg:.1f}° "
                "where the last run left it."
            )
        return self._still("accelerometer", angle_deg)

    def _askew(self, says: str) -> PresenceStatus:
        return PresenceStatus("askew", self.serial, says)

    def _still(self, by: str, angle_deg: float) -> PresenceStatus:
        return PresenceStatus("there", self.serial, f"At rest at {angle_deg:z.1f}° (by {by}).")


def evaluate_board(identity: BoardIdentity, samples: Samples, stage_deg: float | None) -> BoardCheck:
    """What a board's word and its samples of a moment are.

    `stage_deg` is the elevation at which the stage was left; None where that is not known.
    """
    accel_g = samples.accel_g.mean(axis=0)
    if np.isnan(accel_g).any():
        turns = np.exp(1j * np.radians(samples.angle_deg))
        moves = np.degrees(np.angle(turns / turns.mean())).std() > MOVES_DEG
        own_deg = float(np.degrees(np.angle(turns.mean())))
        return BoardCheck(identity.serial, own_deg=own_deg, moves=bool(moves), stage_deg=stage_deg)
    spread_dps = float(np.nan_to_num(samples.gyro_dps.std(axis=0)).max())
    moves = samples.accel_g.std(axis=0).max() > MOVES_G or spread_dps > MOVES_DPS
    x_g, y_g, z_g = accel_g.tolist()
    return BoardCheck(identity.serial, accel_g=(x_g, y_g, z_g), moves=bool(moves), stage_deg=stage_deg)


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
    seen: BoardCheck = field(default=BoardCheck())
    left_open: OpenBoardHandover | None = None
    is_given_up: bool = False


class PresenceMonitor:
    """Looks at the boards of idle rigs, a thread for each that somebody asks for. Thread-safe."""

    def __init__(self, store: Store, crew: WorkerRegistry) -> None:
        self._store, self._crew = store, crew
        self._lock = Lock()
        self._watches: dict[str, _Watch] = {}
        self._is_closing = False

    def look(self, rig: RigSettings) -> None:
        """Has a rig's board looked at for a while; returns at once. Nothing is done while it is busy."""
        if rig.imu is None or not self._crew.is_free(rig.name):
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

    def looks(self) -> dict[str, BoardCheck]:
        """What was seen last on each rig that is looked at."""
        with self._lock:
            return {name: watch.seen for name, watch in self._watches.items()}

    def let_go(self, rig_name: str) -> OpenBoardHandover | None:
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

    def _left_at(self, rig_name: str) -> float | None:
        """The elevation at which the last run left the stage; None where that is not known."""
        try:
            runs, _ = self._store.runs.page(rig=rig_name, limit=1)
            if not runs or runs[0].status != "completed" or "stage" not in runs[0].provenance:
                return None  # stopped on its way, or imported
            poses = self._store.poses.of(runs[0].id)
        except StoreError:
            return None
        return poses[-1].pose.stage_deg if poses else None

    def _watch(self, watch: _Watch) -> None:
        assert watch.rig.imu is not None  # noqa: S101 (as asked for)
        try:
            while True:
                self._require(watch)
                try:
                    self._look_on(watch, watch.rig.imu)
                except InstrumentError as error:
                    watch.seen = BoardCheck(trouble=str(error))
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
            with cancel_scope(lambda: self._require(watch)):
                while True:
                    identity = board.identify()  # again each time: another one may be on the wire
                    is_known = True
                    watch.seen = evaluate_board(identity, _samples(board, identity), stage_deg)
                    watch.let_go.wait(EVERY_S)
                    self._require(watch)
        except _Unwanted:
            if may_stay_open(settings.driver) and self._is_for_a_run(watch):
                if is_known:
                    board.stop()
                watch.left_open = OpenBoardHandover(board, tapes.all)
            raise
        finally:
            if watch.left_open is None:
                board.close()

    def _is_for_a_run(self, watch: _Watch) -> bool:
        """Whether a look has ended because a run takes the rig, which may be about to say so."""
        is_taken = not self._crew.is_free(watch.rig.name) and watch.let_go.wait(LEAVES_S)
        return is_taken and not self._is_closing

    def _require(self, watch: _Watch) -> None:
        """Raises where the rig is needed, or nobody has asked for a while."""
        is_over = watch.let_go.is_set() or self._is_closing or time.monotonic() > watch.until_s
        if is_over or not self._crew.is_free(watch.rig.name):
            raise _Unwanted


def _samples(board: Board, identity: BoardIdentity) -> Samples:
    rate_hz = identity.rate_hz or min(RATE_HZ, identity.max_rate_hz or RATE_HZ)
    wanted, blocks, count = max(FEWEST, round(LOOK_S * rate_hz)), [], 0
    board.start(round(rate_hz))
    while count < wanted:
        raise_if_cancelled()
        block = board.take(TAKE_S)
        count += len(block)
        blocks.append(block)
    board.stop()
    return Samples.join(blocks)
