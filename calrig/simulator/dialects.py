"""The dialects there are, by name, and what makes a device that speaks one.

Each module of `stages` is one, and each of `sketches.SKETCHES`. Importing their names imports no physics,
which launching a simulator does not need.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Protocol

from calrig.simulator import stages
from calrig.simulator.sketches import SKETCHES
from calrig.simulator.wire import Device

if TYPE_CHECKING:
    from calrig.simulator.bench import Bench
    from calrig.simulator.config import BoardFault, BoardOptions, ImuOptions, StageOptions
    from calrig.simulator.stage import Stage


class Board(Device, Protocol):
    """A board with one sensor.

    Attributes:
        fault: breaks it on purpose, at any time.
        driver: what calrig calls the driver for what it prints.
        most_waiting_bytes: what it holds for a reader who does not keep up.
    """

    fault: BoardFault | None
    driver: str
    most_waiting_bytes: int

    def opened(self) -> None:
        """Its port was opened."""


MakesStage = Callable[["StageOptions", "Bench", Callable[[], float]], "Stage"]
MakesBoard = Callable[["BoardOptions", "ImuOptions", "Bench", Callable[[], float]], Board]


STAGES = tuple(found.name.replace("_", "-") for found in pkgutil.iter_modules(stages.__path__))


def stage_of(driver: str) -> MakesStage:
    """What makes the controller of a driver, one of `STAGES`."""
    module = import_module(f"{stages.__name__}.{driver.replace('-', '_')}")
    makes: MakesStage | None = getattr(module, "STAGE", None)
    if makes is None:
        raise TypeError(f"{module.__name__} binds no STAGE, the dialect that it is there for")
    return makes


def board_of(sketch: str | None) -> MakesBoard:
    """What makes the board that runs one of `SKETCHES`, or calrig's own."""
    if sketch is None:
        from calrig.simulator.board import Board as OwnBoard

        return OwnBoard
    from calrig.simulator.sketch_board import SketchBoard

    return partial(SketchBoard, SKETCHES[sketch])
