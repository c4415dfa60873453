"""Whether what a rig measures by has a certificate that is still in date.

A rig's two instruments, opened together and closed together, the stage stopped whatever happened.

Whether board and stage suit a run, once they have said who they are and before anything moves.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from calrig.analysis.errors import Conflict
from calrig.estimation.autoregressive import MIN_SAMPLES
from calrig.instruments.axis import Axis
from calrig.instruments.cancellation import cancel_scope
from calrig.instruments.clock import Clock
from calrig.instruments.drivers import open_board, open_stage
from calrig.instruments.errors import BoardError, InstrumentError, LimitError, PortError
from calrig.instruments.ports import clock_of
from calrig.instruments.standstill import CUT
from calrig.instruments.types import Board, BoardIdentity, Stage, StageIdentity
from calrig.laboratory import STANDARDS
from calrig.runs.assignment import RunAssignment
from calrig.runs.control import Control, StopOutcome
from calrig.runs.stage_position import StagePosition
from calrig.settings import RigSettings

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


log = logging.getLogger(__name__)

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
        if axis.has_moved or control.is_to_end:
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

    Args:
        settings: the rig.
        opened: is called once the port has opened, or has not.

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
