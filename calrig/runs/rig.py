"""A rig's two instruments, opened together and closed together, the stage stopped whatever happened."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass

from calrig.instruments.axis import Axis
from calrig.instruments.clock import Clock
from calrig.instruments.drivers import open_board, open_stage
from calrig.instruments.errors import InstrumentError, PortError
from calrig.instruments.ports import clock_of
from calrig.instruments.standing import CUT
from calrig.instruments.types import Board, BoardIdentity, Stage, StageIdentity
from calrig.instruments.wanted import while_wanted
from calrig.runs.control import Control, Left
from calrig.runs.references import overdue_says
from calrig.runs.stage_place import StagePlace
from calrig.settings import RigSettings

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
    place: StagePlace
    faults_before: Mapping[str, int]

    def faults(self) -> dict[str, int]:
        """Everything odd that the drivers have counted so far, by kind."""
        return dict(Counter(self.faults_before) + Counter(self.board.faults) + Counter(self.stage.faults))

    def provenance(self) -> dict[str, object]:
        """Who and what measured, as it is stored with the run."""
        assert self.settings.stage is not None and self.settings.imu is not None  # noqa: S101 (open_rig saw)
        return {
            "rig": self.settings.model_dump(mode="json", exclude={"filter", "simulated"}),
            "simulated": self.settings.simulated is not None,
            "stage": asdict(self.stage_identity),
            "board": asdict(self.board_identity),
            "filter": self.settings.filter.model_dump(),
            **({"warnings": overdue} if (overdue := overdue_says(self.settings)) else {}),
        }


@contextmanager
def open_rig(
    settings: RigSettings,
    control: Control,
    warn: Callable[[str], None],
    place: StagePlace,
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
        with while_wanted(control.check):
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
        control.leave(Left(seen=True))
    return True


def _stop_when_back(
    settings: RigSettings, clock: Clock, control: Control, warn: Callable[[str], None]
) -> None:
    """Stops a stage whose port went away, should it come back in time; under another name where `usb:`."""
    give_up_s = clock.now_s() + COME_BACK_S
    while True:
        try:
            stop_stage(settings)
            return control.leave(Left(seen=True))
        except PortError as error:
            if clock.now_s() > give_up_s:
                return _not_seen(error, f"the stage could not be told to stop: {CUT}", control, warn)
        except InstrumentError as error:
            return _not_seen(error, str(error), control, warn)
        clock.sleep(AGAIN_S)


def _not_seen(error: InstrumentError, said: str, control: Control, warn: Callable[[str], None]) -> None:
    """Tells whoever waits, and the run, that the stage is not known to stand."""
    log.warning("could not see the stage stopped: %s", error)
    control.leave(Left(seen=True, trouble=said))
    warn(said)
