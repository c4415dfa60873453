"""Open and close a rig for a run, and store the position of a stage without homing between processes.

Opening the port of such a stage resets its Arduino, whose count starts again at any table angle. So the store
holds the last position, and holds it as unknown from before each move until standstill. A user's statement of
the position applies to one run, and is stored once gravity confirms it.

However a run ends, both instruments are closed together and the stage is stopped.
"""

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from calrig.analysis.errors import Conflict, Invalid, NotTheSame
from calrig.analysis.known_calibration import known_calibration
from calrig.estimation.angles import wrap_deg
from calrig.estimation.autoregressive import MIN_SAMPLES
from calrig.instruments.axis import Axis
from calrig.instruments.cancellation import cancel_scope
from calrig.instruments.clock import Clock
from calrig.instruments.drivers import open_board, open_stage
from calrig.instruments.errors import BoardError, InstrumentError, LimitError, PortError, StageError
from calrig.instruments.ports import clock_of
from calrig.instruments.standstill import CUT
from calrig.instruments.types import Board, BoardIdentity, Stage, StageIdentity
from calrig.laboratory import STANDARDS
from calrig.runs.assignment import RunAssignment
from calrig.runs.control import Control, StopOutcome
from calrig.runs.mounting import Mounting
from calrig.settings import RigSettings
from calrig.store import Run, Store

log = logging.getLogger(__name__)

MOST_OFF_DEG = 10.0
"""A unit's offsets before any calibration turn its gravity by half of this."""
SAY_SO = "turn the stage by hand to an elevation that you know and say which"
STARTED_BY = (
    f'{SAY_SO}: "The stage stands at" where the page starts a run, `calrig run --stage-at DEGREES`, or '
    "`stage_at_deg` of POST /api/runs"
)


class StagePosition:
    """One rig's stage. It writes nothing of a stage that can home.

    Args:
        said_deg: a person's word for the elevation at which it stands; None where nobody said.
        resumes: whether the run was interrupted, and can be resumed later where it cannot now.
    """

    def __init__(
        self, store: Store, rig: RigSettings, run: Run, said_deg: float | None, *, resumes: bool
    ) -> None:
        self._store, self._rig, self._unit, self._said_deg = store, rig, run.unit, said_deg
        self._refusal = NotTheSame if resumes else StageError
        self._say_so = resumed_by(run.id) if resumes else STARTED_BY
        self._remembers = False

    def take_up(self, axis: Axis, *, homes: bool) -> None:
        """Tells the axis where its stage stands, by a person's word or as it was left, before anything moves.

        Raises:
            StageError: it was left on its way, and nobody knows where.
        """
        self._remembers = not homes
        if homes:
            return
        if self._said_deg is not None:
            axis.stands_at(self._said_deg)
            return
        left = self._store.positions.of(self._rig.name)
        if left is None:
            return
        if left.stage_deg is None:
            raise StageError(
                f"rig {self._rig.name!r}: its stage has no homing, and was left on its way or lost steps: "
                f"where it stands is not known; nothing was moved: {self._say_so}"
            )
        zero_deg, gain = _of(self._rig)
        axis.stands_at((left.stage_deg - zero_deg) / gain)

    def check_gravity(self, stage_deg: float, felt_deg: float, mount: Mounting) -> None:
        """Holds where a stage without homing is said to stand against the gravity that the unit feels there.

        Stores it where they agree.

        `felt_deg` is the elevation by the unit's accelerometer.

        Raises:
            StageError: they differ by more than the unit's known bias and `MOST_OFF_DEG`.
            NotTheSame: likewise, of a run that was interrupted.
        """
        if not self._remembers:
            return
        expected_deg = self._expected_deg(stage_deg, mount)
        if abs(wrap_deg(felt_deg - expected_deg)) <= MOST_OFF_DEG:
            self.stands(stage_deg)
            return
        raise self._refusal(
            f"rig {self._rig.name!r}: the stage is said to stand at {stage_deg:.1f}°, where the unit should "
            f"read {expected_deg:.1f}°, and gravity says {felt_deg:.1f}°; nothing was moved: see that the "
            f"unit sits as it should, then {self._say_so}"
        )

    def leaves(self) -> None:
        """A motion is about to be sent: until it has ended, nobody knows."""
        if self._remembers:
            self._store.positions.save(self._rig.name, None)

    def stands(self, elevation_deg: float) -> None:
        """It has come to stand."""
        if self._remembers:
            zero_deg, gain = _of(self._rig)
            self._store.positions.save(self._rig.name, zero_deg + gain * elevation_deg)

    def is_lost(self) -> None:
        """The stage is not where it says."""
        self.leaves()
        self._remembers = False

    def doubted(self, why: NotTheSame) -> NotTheSame:
        """What a resumed run is to say whose unit reads otherwise than before; the place is not stored."""
        if not self._remembers:
            return why
        self.is_lost()
        return NotTheSame(f"{why}; where the stage did not stand as it was said to, {self._say_so}")

    def was_stopped(self, axis: Axis) -> None:
        """It was halted, maybe on its way; where it can tell where that is, that is kept."""
        if not self._remembers:
            return
        try:
            self.stands(axis.elevation_deg())
        except InstrumentError:  # why, the run's own failure says
            log.warning("where the stage of rig %r was left is not known", self._rig.name)
            self.leaves()

    def _expected_deg(self, stage_deg: float, mount: Mounting) -> float:
        """What the unit reads there by its calibration in force; the elevation, if none is of this rig."""
        theta_deg = wrap_deg(mount.felt_at(stage_deg))
        known = known_calibration(self._store, self._unit)
        if known is None or known.run.rig != self._rig.name or mount.axis != "x":
            return theta_deg
        return known.result.bias_deg + (known.result.scale or 1.0) * theta_deg


def resumed_by(run_id: str) -> str:
    """How a person says where the stage of an interrupted run stands."""
    return (
        f'{SAY_SO}: "The stage stands at" where the page resumes the run, `calrig resume {run_id} --stage-at '
        f"DEGREES`, or `stage_at_deg` of POST /api/runs/{run_id}/resume; or end the run"
    )


def check_stage_at(run: Run, stage_at_deg: float | None) -> None:
    """Sees that a person's word on where a stage stands is one that resuming a run can take.

    Raises:
        Conflict: the run is not interrupted: its stage's place is known, or others move it before.
        Invalid: its stage can home.
    """
    if stage_at_deg is None:
        return
    if run.status != "interrupted":
        raise Conflict(f"run {run.id} is {run.status}, not interrupted: resume it without stage_at_deg")
    if _homes(run):
        raise Invalid(
            f"the stage of run {run.id} has homing and finds its place by itself: resume it without "
            "stage_at_deg",
            ["stage_at_deg"],
        )


def is_lost_since(store: Store, run: Run) -> bool:
    """Whether a run's stage has no homing, and was left on its way or lost steps."""
    left = None if run.rig is None or _homes(run) else store.positions.of(run.rig)
    return left is not None and left.stage_deg is None


def _homes(run: Run) -> bool:
    """Whether a run's stage has said that it can home; one that has not been asked yet has not."""
    return bool((run.provenance.get("stage") or {}).get("homes"))


def _of(rig: RigSettings) -> tuple[float, float]:
    """The stage's own angle at elevation 0, and its degrees per degree of elevation."""
    if rig.stage is None:
        return 0.0, 1.0
    return rig.stage.zero_deg, rig.stage.sign * rig.stage.ratio


CALLED = dict(zip(STANDARDS, ("the stage", "the thermometer", "the time base"), strict=True))


def overdue_says(rig: RigSettings) -> list[str]:
    """A sentence for each standard whose certificate is overdue today (UTC)."""
    today = datetime.now(UTC).date()
    said = []
    for key in STANDARDS:
        standard = getattr(rig, key)
        if standard is not None and standard.due is not None and today > standard.due:
            named = f" {standard.certificate}" if standard.certificate else ""
            said.append(
                f"The certificate{named} of {CALLED[key]} of rig {rig.name} was due on {standard.due} and is "
                "overdue."
            )
    return said


def require_in_date(rig: RigSettings) -> None:
    """Raises Conflict where a certificate is overdue and the rig is not to measure then."""
    if rig.overdue == "refuse" and (said := overdue_says(rig)):
        raise Conflict(
            f"{' '.join(said)} Nothing was moved: have it calibrated and enter its new certificate, or set "
            'overdue = "flag" for this rig'
        )


STANDS_S = 2.0
"""How long a stage may take to say that it stands once it was told to stop."""
COME_BACK_S = 1.5
"""How long a port that went away is waited for, so that its stage can be told to stop."""
AGAIN_S = 0.1


@dataclass(frozen=True, slots=True)
class Rig:
    """An open rig: who its instruments say they are, and the two of them.

    `clock` is the time that both live in; `place` remembers where a stage without homing stands;
    `faults_before` are those of a run before it was interrupted.
    """

    settings: RigSettings
    clock: Clock
    axis: Axis
    stage: Stage
    board: Board
    stage_identity: StageIdentity
    board_identity: BoardIdentity
    place: StagePosition
    faults_before: Mapping[str, int]

    def faults(self) -> dict[str, int]:
        """Everything odd that the drivers have counted so far, by kind."""
        return dict(Counter(self.faults_before) + Counter(self.board.faults) + Counter(self.stage.faults))

    def provenance(self) -> dict[str, object]:
        """Who and what measured, as it is stored with the run."""
        stage = asdict(self.stage_identity)
        warnings = [*overdue_says(self.settings), *stage.pop("warnings")]
        assert self.settings.stage is not None and self.settings.imu is not None  # noqa: S101 (open_rig saw)
        return {
            "rig": self.settings.model_dump(mode="json", exclude={"filter", "simulated"}),
            "simulated": self.settings.simulated is not None,
            "stage": stage,
            "board": asdict(self.board_identity),
            "filter": self.settings.filter.model_dump(),
            **({"warnings": warnings} if warnings else {}),
        }


@contextmanager
def open_rig(
    settings: RigSettings,
    control: Control,
    warn: Callable[[str], None],
    place: StagePosition,
    faults_before: Mapping[str, int],
    board: Board | None = None,
) -> Iterator[Rig]:
    """Opens and identifies both instruments of a rig; moves nothing.

    Args:
        settings: the rig, with the ports of both instruments.
        control: is given the way to halt the stage as soon as there is one, and told how it was left; what
            is done with the rig, identifying it too, ends soon after an end was asked of it.
        warn: is told where the stage, left behind, is not known to stand.
        place: is told where a stopped stage stands.
        faults_before: counts that the run has already.
        board: where it is open already; it is closed with the rest.

    Raises:
        InstrumentError: a port does not open, or a device does not answer as it should.
        Ended: an end was asked for.
    """
    if settings.stage is None or settings.imu is None:
        raise _no_ports(settings)
    clock = clock_of(settings.stage.port)
    axis = _open_axis(settings)
    control.arm(axis.halt)
    imu = settings.imu
    try:
        with cancel_scope(control.check):
            board = board or open_board(imu.driver, imu.port, baudrate=imu.baudrate)
            stage, sensor = axis.identify(), board.identify()
            yield Rig(settings, clock, axis, axis.stage, board, stage, sensor, place, faults_before)
    finally:
        out_of_reach = False
        if axis.has_moved or control.asked is not None:
            out_of_reach = not _told_to_stop(axis, control, warn)
        if axis.has_moved and not out_of_reach:
            place.was_stopped(axis)
        if board is not None:
            board.close()
        axis.close()
        if out_of_reach:
            _stop_when_back(settings, clock, control, warn)


def stop_stage(settings: RigSettings, opened: Callable[[], None] = lambda: None) -> None:
    """Opens the stage of a rig that nobody uses, tells it to stop, sees that it stands, and closes it.

    `opened` is called once the port has opened, or has not.

    Raises:
        InstrumentError: the rig has no port, or it does not open, or the stage is not known to stand.
    """
    try:
        axis = _open_axis(settings)
    finally:
        opened()
    with closing(axis):
        axis.confirm_stopped(STANDS_S)


def _no_ports(settings: RigSettings) -> InstrumentError:
    return InstrumentError(f"rig {settings.name!r} has no ports: its simulated devices are not running")


def _open_axis(settings: RigSettings) -> Axis:
    stage = settings.stage
    if stage is None:
        raise _no_ports(settings)
    return Axis(
        open_stage(stage.driver, stage.port, axis=stage.axis, baudrate=stage.baudrate),
        zero_deg=stage.zero_deg,
        sign=stage.sign,
        ratio=stage.ratio,
        limits_deg=settings.limits_deg,
        tolerance_deg=stage.tolerance_deg,
        clock=clock_of(stage.port),
    )


def _told_to_stop(axis: Axis, control: Control, warn: Callable[[str], None]) -> bool:
    """Halts a stage that may have moved, and waits until it stands; False where its port is gone."""
    try:
        axis.confirm_stopped(STANDS_S)
    except PortError as error:
        log.warning("could not see the stage stopped: %s", error)
        return False
    except InstrumentError as error:
        _not_seen(error, str(error), control, warn)
    else:
        control.leave(StopOutcome(seen=True))
    return True


def _stop_when_back(
    settings: RigSettings, clock: Clock, control: Control, warn: Callable[[str], None]
) -> None:
    """Stops a stage whose port went away, should it come back in time; under another name where `usb:`."""
    give_up_s = clock.now_s() + COME_BACK_S
    while True:
        try:
            stop_stage(settings)
            return control.leave(StopOutcome(seen=True))
        except PortError as error:
            if clock.now_s() > give_up_s:
                return _not_seen(error, f"the stage could not be told to stop: {CUT}", control, warn)
        except InstrumentError as error:
            return _not_seen(error, str(error), control, warn)
        clock.sleep(AGAIN_S)


def _not_seen(error: InstrumentError, said: str, control: Control, warn: Callable[[str], None]) -> None:
    """Tells whoever waits, and the run, that the stage is not known to stand."""
    log.warning("could not see the stage stopped: %s", error)
    control.leave(StopOutcome(seen=True, trouble=said))
    warn(said)


def require_suited(rig: Rig, task: RunAssignment) -> None:
    """Raises where the board does not suit unit or plan, or a pose is beyond the controller's limits."""
    board, unit, name = rig.board_identity, task.run.unit, task.rig.name
    if board.serial and board.serial != unit:
        raise BoardError(
            f"rig {name!r}: the board says it is unit {board.serial!r}, the run is for unit "
            f"{unit!r}; nothing was moved: mount the right unit or correct the serial number"
        )
    if task.plan.kind == "sweep" and not board.sends_rates:
        raise BoardError(
            f"rig {name!r}: board {board.driver} sends no rates and accelerations, which a sweep needs; "
            "nothing was moved: take a plan of dwells"
        )
    if board.rate_hz is not None:
        _require_long_dwell(name, task.plan.dwell_s, board.rate_hz)
    elif board.max_rate_hz is not None and task.plan.rate_hz > board.max_rate_hz:
        raise BoardError(
            f"rig {name!r}: the plan asks for {task.plan.rate_hz} Hz and the board gives "
            f"{board.max_rate_hz} Hz at most; nothing was moved: lower rate_hz"
        )
    low, high = rig.axis.limits_deg  # the controller's own may be narrower than those of the configuration
    for pose in task.planned:
        if not low <= pose.target_deg <= high:
            raise LimitError(
                f"rig {name!r}: elevation {pose.target_deg:g}° is beyond the limits of rig and "
                f"controller together, {low:g}° to {high:g}°; nothing was moved: change the plan, or the "
                "controller's limits"
            )


def _require_long_dwell(name: str, dwell_s: float, rate_hz: float) -> None:
    """A board that has one rate only may be too slow for the plan's dwell."""
    count = dwell_s * rate_hz
    if count < MIN_SAMPLES:
        enough_s = math.ceil(2 * (MIN_SAMPLES + 1) / rate_hz) / 2
        raise BoardError(
            f"rig {name!r}: the board gives {rate_hz:.1f} samples a second and no other rate: a "
            f"dwell of {dwell_s:g} s holds about {count:.0f}, a reading needs {MIN_SAMPLES}; "
            f"nothing was moved: dwell longer (dwell_s at least {enough_s:g})"
        )
