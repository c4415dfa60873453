"""Devices by name: the built-in ones, and those that other packages offer as entry points.

Each folder under `stages` and `boards` that is a package declares its `DEVICE`, and `boards.public_sketches`
has the sketches that print text; nothing else lists them.
Another package adds a stage with the entry-point group `calrig.stages`, a board with `calrig.boards`. The
entry point's name is the driver's. Its object is a `StageDevice` or `BoardDevice`, which takes part in scans,
or only a function that opens one.
"""

from __future__ import annotations

import logging
import pkgutil
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar, cast

from calrig.instruments import boards, stages
from calrig.instruments.boards.public_sketches import SKETCHES
from calrig.instruments.boards.sketch import board_device
from calrig.instruments.device import AnyDevice, BoardDevice, OpenBoard, OpenStage, StageDevice
from calrig.instruments.errors import InstrumentError

if TYPE_CHECKING:
    from calrig.instruments.types import Board, Stage

T = TypeVar("T", StageDevice, BoardDevice)
log = logging.getLogger(__name__)


def _built_in(folder: ModuleType, kind: type[T]) -> dict[str, T]:
    devices = {}
    for found in pkgutil.iter_modules(folder.__path__, f"{folder.__name__}."):
        if not found.ispkg:
            continue  # what several devices share
        device = getattr(import_module(found.name), "DEVICE", None)
        if not isinstance(device, kind):
            raise TypeError(f"{found.name} declares no DEVICE that is a {kind.__name__}")
        if device.driver.replace("-", "_") != found.name.rpartition(".")[2]:
            raise TypeError(f"{found.name} declares driver {device.driver!r}, whose folder has another name")
        devices[device.driver] = device
    return devices


STAGES: Mapping[str, StageDevice] = _built_in(stages, StageDevice)
BOARDS: Mapping[str, BoardDevice] = {
    **_built_in(boards, BoardDevice),
    **{sketch.driver: board_device(sketch) for sketch in SKETCHES},
}


def open_stage(driver: str, port: str, *, axis: int = 1, baudrate: int | None = None) -> Stage:
    """Opens a stage.

    Raises:
        InstrumentError: no driver of that name; names those there are.
        PortError: the port cannot be opened.
    """
    opens = STAGES[driver].opens if driver in STAGES else _offered("stage", driver, STAGES)
    return cast("OpenStage", opens)(port, axis=axis, baudrate=baudrate)


def open_board(driver: str, port: str, *, baudrate: int | None = None) -> Board:
    """Opens a board.

    Raises:
        InstrumentError: no driver of that name; names those there are.
        PortError: the port cannot be opened.
    """
    opens = BOARDS[driver].opens if driver in BOARDS else _offered("board", driver, BOARDS)
    return cast("OpenBoard", opens)(port, baudrate=baudrate)


def may_stay_open(driver: str) -> bool:
    """Return whether a board opened for a presence check may be handed to a run; only built-in ones may."""
    return driver in BOARDS and BOARDS[driver].may_stay_open


def known_devices() -> list[AnyDevice]:
    """All that a scan can recognise: the built-in devices, and what is offered as a device."""
    devices: list[AnyDevice] = [*STAGES.values(), *BOARDS.values()]
    for kind, built_in in (("stage", STAGES), ("board", BOARDS)):
        for entry in entry_points(group=f"calrig.{kind}s"):
            if entry.name in built_in:
                continue
            try:
                offered = _load(kind, entry)
            except InstrumentError as error:
                log.warning("not looked for in a scan: %s", error)
                continue
            if isinstance(offered, StageDevice | BoardDevice) and offered not in devices:
                devices.append(offered)
    return devices


def require_known(stage: str, board: str) -> None:
    """Raises InstrumentError where there is no stage driver, or no board driver, of a name; opens nothing."""
    for kind, driver, built_in in (("stage", stage, STAGES), ("board", board, BOARDS)):
        if driver not in built_in:
            _entry(kind, driver, built_in)


def _entry(kind: str, driver: str, built_in: Mapping[str, AnyDevice]) -> EntryPoint:
    offered = entry_points(group=f"calrig.{kind}s")
    if driver not in offered.names:
        known = ", ".join(sorted({*built_in, *offered.names}))
        raise InstrumentError(f"no {kind} driver is called {driver!r}; there are: {known}")
    return offered[driver]


def _offered(kind: str, driver: str, built_in: Mapping[str, AnyDevice]) -> object:
    """What opens a device that another package offers."""
    loaded = _load(kind, _entry(kind, driver, built_in))
    return loaded.opens if isinstance(loaded, StageDevice | BoardDevice) else loaded


def _load(kind: str, entry: EntryPoint) -> object:
    try:
        return entry.load()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InstrumentError(
            f"{kind} driver {entry.name!r} is installed but cannot be loaded: {error}"
        ) from error
