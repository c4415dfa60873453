"""A whole simulated rig in this process: a bench, its devices, and the ports they answer on."""

import time
from collections.abc import Callable
from functools import partial
from typing import Protocol, Self

from calrig.simulator.bench import Bench
from calrig.simulator.clamp import IndexClamp
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import board_of, stage_of
from calrig.simulator.wire import MOST_WAITING_BYTES, Device, Wire, open_port


class ScaledClock:
    """Seconds of simulated time since it was made: `time_scale` for every second of `now_s`.

    Nothing else in the simulator knows how fast time runs.
    """

    def __init__(self, time_scale: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._time_scale = time_scale
        self._now_s = now_s
        self._start_s = now_s()

    def __call__(self) -> float:
        """The simulated time in seconds; never goes back."""
        return self._time_scale * (self._now_s() - self._start_s)


class DevicePort(Protocol):
    """A device and its port, from `start` until `stop`; `url` is what a client opens."""

    url: str

    def start(self) -> None:
        """Switches the device on."""

    def stop(self) -> None:
        """Pulls it out."""


PlugIn = Callable[[Device, str, int, Callable[[], None]], DevicePort]
"""Gives a device a port: by a name, the most bytes that wait unread, and a callback for its opening."""


class SimulatedRig:
    """A stage and a board behind two serial ports, and a clamp behind a third where there is one.

    From `start` (or `with`) until `stop`.

    Attributes:
        clock: simulated time in seconds since it was made, when called.
        bench: its physics; take `bench.lock` while the rig is running.
        stage, board: its devices; their `fault` may be set at any time.
        stage_wire, board_wire, clamp_wire: each can be pulled out by its `stop`.
        stage_port, imu_port: what `serial.serial_for_url` opens.
        stage_driver, imu_driver: of calrig, that understand them.

    `now_s` is its time, seconds which never go back. `plug_in` gives its devices their ports; without it they
    are the system's.
    """

    def __init__(
        self,
        settings: SimulatorSettings,
        now_s: Callable[[], float] = time.monotonic,
        plug_in: PlugIn | None = None,
    ) -> None:
        plug_in = plug_in or partial(_plugged, settings)
        self.settings = settings
        self.clock = ScaledClock(settings.time_scale, now_s)
        self.bench = Bench(settings)
        self.stage = stage_of(settings.stage.driver)(settings.stage, self.bench, self.clock)
        self.board = board_of(settings.board.sketch)(settings.board, settings.imu, self.bench, self.clock)
        self.stage_driver, self.imu_driver = settings.stage.driver, self.board.driver
        self.stage_wire = plug_in(self.stage, "stage", MOST_WAITING_BYTES, _ignore_opening)
        self.board_wire = plug_in(self.board, "board", self.board.most_waiting_bytes, self.board.opened)
        self.stage_port, self.imu_port = self.stage_wire.url, self.board_wire.url
        self.clamp_wire: DevicePort | None = None
        if settings.clamp is not None:
            clamp = IndexClamp(settings.clamp, self.bench, self.clock)
            self.clamp_wire = plug_in(clamp, "clamp", MOST_WAITING_BYTES, _ignore_opening)

    @property
    def clamp_port(self) -> str | None:
        """What `serial.serial_for_url` opens to have the unit turned; None where hands do that."""
        return None if self.clamp_wire is None else self.clamp_wire.url

    def _wires(self) -> list[DevicePort]:
        clamp = [] if self.clamp_wire is None else [self.clamp_wire]
        return [self.stage_wire, self.board_wire, *clamp]

    def start(self) -> None:
        """Switches its devices on."""
        for wire in self._wires():
            wire.start()

    def stop(self) -> None:
        """Switches them off and closes the ports."""
        for wire in self._wires():
            wire.stop()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def _ignore_opening() -> None:
    """For a device that an opened port does not reset."""


def _plugged(
    settings: SimulatorSettings,
    device: Device,
    name: str,
    most_waiting_bytes: int,
    opened: Callable[[], None],
) -> Wire:
    return Wire(device, open_port(settings.ports, opened), f"simulated {name}", most_waiting_bytes)
