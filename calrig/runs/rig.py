"""A rig's two instruments, opened together and closed together, the stage stopped whatever happened."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass

from calrig.instruments.axis import Axis
from calrig.instruments.drivers import open_board, open_stage
from calrig.instruments.errors import InstrumentError, PortError
from calrig.instruments.types import Board, BoardIdentity, Stage, StageIdentity
from calrig.settings import RigSettings, StageSettings

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Rig:
    """An open rig: who its instruments say they are, and the two of them."""

    settings: RigSettings
    axis: Axis
    stage: Stage
    board: Board
    stage_identity: StageIdentity
    board_identity: BoardIdentity

    def faults(self) -> dict[str, int]:
        """Everything odd that the drivers have counted so far, by kind."""
        return dict(Counter(self.board.faults) + Counter(self.stage.faults))

    def provenance(self) -> dict[str, object]:
        """Who and what measured, as it is stored with the run."""
        assert self.settings.stage is not None and self.settings.imu is not None  # noqa: S101 (open_rig saw)
        return {
            "rig": self.settings.model_dump(mode="json", exclude={"filter", "simulated"}),
            "simulated": self.settings.simulated is not None,
            "stage": asdict(self.stage_identity),
            "board": asdict(self.board_identity),
            "filter": self.settings.filter.model_dump(),
        }


@contextmanager
def open_rig(
    settings: RigSettings, arm: Callable[[Callable[[], None]], None], warn: Callable[[str], None]
) -> Iterator[Rig]:
    """Opens and identifies both instruments of a rig; moves nothing.

    Args:
        settings: the rig, with the ports of both instruments.
        arm: is given the way to halt the stage as soon as there is one.
        warn: is told where the stage, left behind, is not known to stand.

    Raises:
        InstrumentError: a port does not open, or a device does not answer as it should.
    """
    if settings.stage is None or settings.imu is None:
        raise InstrumentError(f"rig {settings.name!r} has no ports: its simulated devices are not running")
    stage = _open_stage(settings.stage)
    axis = Axis(
        stage,
        zero_deg=settings.stage.zero_deg,
        sign=settings.stage.sign,
        ratio=settings.stage.ratio,
        limits_deg=settings.limits_deg,
        tolerance_deg=settings.stage.tolerance_deg,
    )
    arm(axis.halt)
    board: Board | None = None
    try:
        board = open_board(settings.imu.driver, settings.imu.port, baudrate=settings.imu.baudrate)
        yield Rig(settings, axis, stage, board, axis.identify(), board.identify())
    finally:
        if axis.has_moved:
            _leave_stopped(axis, warn)
        if board is not None:
            board.close()
        axis.close()


def stop_idle_stage(settings: RigSettings) -> None:
    """Opens a rig's stage, tells it to stop, and closes it.

    Raises:
        InstrumentError: the rig has no port, or it does not open or take the command.
    """
    if settings.stage is None:
        raise InstrumentError(f"rig {settings.name!r} has no ports: its simulated devices are not running")
    stage = _open_stage(settings.stage)
    try:
        stage.halt()
    finally:
        stage.close()


def _open_stage(settings: StageSettings) -> Stage:
    return open_stage(settings.driver, settings.port, axis=settings.axis, baudrate=settings.baudrate)


def _leave_stopped(axis: Axis, warn: Callable[[str], None]) -> None:
    """Halts a stage that may have moved and waits until it says that it stands."""
    try:
        axis.confirm_stopped(2.0)
    except PortError as error:
        log.warning("could not see the stage stopped: %s", error)
        warn("the stage could not be told to stop: cut its motor power")
    except InstrumentError as error:
        log.warning("could not see the stage stopped: %s", error)
        warn(str(error))
