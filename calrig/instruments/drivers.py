"""Drivers by name: the built-in ones, and those that other packages offer as entry points.

A package adds a stage with the entry-point group `calrig.stages`, a board with `calrig.boards`; the entry
point's name is the driver's, its object a callable like the ones below.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from importlib.metadata import entry_points
from typing import Protocol, TypeVar, cast

from calrig.instruments.boards.calrig.driver import CalrigBoard
from calrig.instruments.boards.sketches.catalogue import SKETCHES
from calrig.instruments.boards.sketches.driver import SketchBoard
from calrig.instruments.errors import InstrumentError
from calrig.instruments.stages.esp301.driver import Esp301
from calrig.instruments.stages.grbl.driver import Grbl
from calrig.instruments.stages.smc100.driver import Smc100
from calrig.instruments.stages.zaber.driver import Zaber
from calrig.instruments.types import Board, Stage


class OpenStage(Protocol):
    """Opens a stage's port; moves nothing. Without a baudrate the driver's own is used."""

    def __call__(self, url: str, *, axis: int, baudrate: int | None) -> Stage: ...  # noqa: D102


class OpenBoard(Protocol):
    """Opens a board's port. Without a baudrate the driver's own is used."""

    def __call__(self, url: str, *, baudrate: int | None) -> Board: ...  # noqa: D102


STAGES: Mapping[str, OpenStage] = {
    "smc100": Smc100.open,
    "grbl": Grbl.open,
    "esp301": Esp301.open,
    "zaber": Zaber.open,
}
BOARDS: Mapping[str, OpenBoard] = {
    "calrig": CalrigBoard.open,
    **{sketch.driver: partial(SketchBoard.open, sketch=sketch) for sketch in SKETCHES},
}

T = TypeVar("T")


def open_stage(driver: str, port: str, *, axis: int = 1, baudrate: int | None = None) -> Stage:
    """Opens a stage.

    Raises:
        InstrumentError: no driver of that name; names those there are.
        PortError: the port cannot be opened.
    """
    return _find(STAGES, "stage", driver)(port, axis=axis, baudrate=baudrate)


def open_board(driver: str, port: str, *, baudrate: int | None = None) -> Board:
    """Opens a board.

    Raises:
        InstrumentError: no driver of that name; names those there are.
        PortError: the port cannot be opened.
    """
    return _find(BOARDS, "board", driver)(port, baudrate=baudrate)


def _find(built_in: Mapping[str, T], kind: str, driver: str) -> T:
    if driver in built_in:
        return built_in[driver]
    offered = entry_points(group=f"calrig.{kind}s")
    if driver not in offered.names:
        known = ", ".join(sorted({*built_in, *offered.names}))
        raise InstrumentError(f"no {kind} driver is called {driver!r}; there are: {known}")
    try:
        return cast("T", offered[driver].load())
    except (ImportError, AttributeError) as error:
        raise InstrumentError(
            f"{kind} driver {driver!r} is installed but cannot be loaded: {error}"
        ) from error
