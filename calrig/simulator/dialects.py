"""The dialects there are, by name, and what makes a device that speaks one.

Each module of `stages` and `boards` is one; nothing else lists them. Their names are
known without importing one, since launching a simulator needs no physics.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol

from calrig.simulator import boards, stages
from calrig.simulator.wire import Device

if TYPE_CHECKING:
    from calrig.simulator.bench import Bench
    from calrig.simulator.config import BoardFault, BoardOptions, ImuOptions, StageOptions
    from calrig.simulator.stage import Stage

OWN_SKETCH = "calrig"


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


def _names(folder: ModuleType) -> tuple[str, ...]:
    return tuple(found.name.replace("_", "-") for found in pkgutil.iter_modules(folder.__path__))


STAGES = _names(stages)
SKETCHES = tuple(name for name in _names(boards) if name != OWN_SKETCH)


def stage_of(driver: str) -> MakesStage:
    """What makes the controller of a driver, one of `STAGES`."""
    makes: MakesStage = _bound(stages, driver, "STAGE")
    return makes


def board_of(sketch: str | None) -> MakesBoard:
    """What makes the board that runs one of `SKETCHES`, or calrig's own."""
    makes: MakesBoard = _bound(boards, sketch or OWN_SKETCH, "BOARD")
    return makes


def _bound(folder: ModuleType, name: str, what: str) -> Any:
    module = import_module(f"{folder.__name__}.{name.replace('-', '_')}")
    makes = getattr(module, what, None)
    if not callable(makes):
        raise TypeError(f"{module.__name__} binds no {what}, the dialect that it is there for")
    return makes
