"""The sketch built once a session, and boards that run it until their test ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import serial
from firmware_board import FirmwareBoard, Line
from firmware_build import TWIN, build_core, build_harness, build_sketch, build_twin, missing
from firmware_physics import Served, Swing
from firmware_twin import Twin
from virtual_time.clock import VirtualClock


class Built(NamedTuple):
    """The harness, and the sketch's ELF file for a baud rate."""

    harness: Path
    elf: Callable[[int], Path]


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """Everything compiled; without the tools the test is skipped, saying what to install."""
    if lacking := missing():
        pytest.skip(f"the firmware is not run: {lacking}")
    folder = tmp_path_factory.mktemp("firmware")
    core = build_core(folder)
    return Built(build_harness(folder), cache(lambda baudrate: build_sketch(folder, core, baudrate)))


class Bench(NamedTuple):
    """A board that runs the sketch, a line to it on which it has said who it is, and what its sensor gave."""

    board: FirmwareBoard
    line: Line
    served: Served
    identity: str


@pytest.fixture
def switch_on(built: Built) -> Iterator[Callable[..., Bench]]:
    """Switches boards on, four times faster than life; they end with the test."""
    with ExitStack() as stack:

        def on(baudrate: int = 115200, counts: Any = None, speed: float = 4.0) -> Bench:
            served = Served(counts or Swing())
            board = stack.enter_context(FirmwareBoard(built.harness, built.elf(baudrate), served, speed))
            line = stack.enter_context(closing(Line(board.port)))
            return Bench(board, line, served, line.next(1)[1])

        yield on


@pytest.fixture
def bench(switch_on: Callable[..., Bench]) -> Bench:
    """A board at 115200 with a healthy sensor."""
    return switch_on()


@pytest.fixture(scope="session")
def twin_program(built: Built, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rig of ../shared/twin, compiled; skips where it is not there."""
    if not TWIN.is_file():
        pytest.skip(f"the simulated controllers are not in {TWIN.parent}")
    return build_twin(tmp_path_factory.mktemp("twin"))


@pytest.fixture
def start_twin(
    built: Built, twin_program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Twin]]:
    """Switches a twin on whose board runs the sketch; it ends with the test."""
    with ExitStack() as stack:

        def start(clock: VirtualClock, options: str = "") -> Twin:
            # What opens a serial port of the system lives in this clock, as what opens `sim://` does.
            monkeypatch.setattr(serial.Serial, "clock", clock, raising=False)
            return stack.enter_context(Twin(twin_program, built.elf(115200), tmp_path, clock, options))

        yield start
