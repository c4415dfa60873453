"""The simulated counterpart of every built-in device, in virtual time, at the end of a UART with a rate."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from calrig.instruments import scan
from calrig.instruments.drivers import BOARDS, STAGES
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.dialects import board_of, stage_of

READ_S = 0.02
"""What a read that finds nothing waits."""


class Counterpart:
    """A device and the bench it stands on; its time is what the test makes of it."""

    def __init__(self, driver: str, serial: str = "AS-0042", sketch: str = "", **stage):
        self.driver = driver
        self.now_s = 0.0
        if driver in STAGES:
            options = {"stage": {"driver": driver, "homing": False, **stage}}
        elif driver == "calrig":
            options = {"board": {"serial": serial}}
        else:
            options = {"board": {"sketch": sketch or driver}}
        settings = SimulatorSettings.from_options({"preset": "ideal", "time_scale": 1, **options})
        self.bench = Bench(settings)
        if driver in STAGES:
            self.device = stage_of(driver)(settings.stage, self.bench, lambda: self.now_s)
        else:
            makes = board_of(settings.board.sketch)
            self.device = makes(settings.board, settings.imu, self.bench, lambda: self.now_s)

    @property
    def baudrate(self) -> int:
        return {**STAGES, **BOARDS}[self.driver].baudrate

    def table_deg(self):
        """Where the table was, is, and is going to be."""
        with self.bench.lock:
            return self.bench.mechanics.table(np.linspace(0, self.now_s + 600, 500)).angle_deg


class Uart:
    """A port of the host's with the counterpart at its other end; each sends and hears at its own rate.

    Its clock goes on as it is read.
    """

    name = "test-port"

    def __init__(self, far: Counterpart, baudrate: int = 9600):
        self.far = far
        self.clock = SimpleNamespace(now_s=lambda: far.now_s)
        self._baudrate = baudrate
        self._arrived = b""

    def change_baudrate(self, baudrate: int) -> None:
        self._baudrate = baudrate

    def write(self, data: bytes) -> None:
        self._arrive(self.far.device.receive(as_heard(data, self._baudrate, self.far.baudrate)))

    def read_some(self) -> bytes:
        self.far.now_s += READ_S
        self._arrive(self.far.device.emit())
        data, self._arrived = self._arrived, b""
        return data

    def close(self) -> None:
        pass

    def _arrive(self, sent: bytes) -> None:
        self._arrived += as_heard(sent, self.far.baudrate, self._baudrate)


def plug(monkeypatch, **drivers: str) -> dict[str, Counterpart]:
    """Counterparts on the ports that the system lists: `plug(monkeypatch, ttyUSB0="grbl")`."""
    far = {port: Counterpart(driver) for port, driver in drivers.items()}
    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo(port) for port in far])
    monkeypatch.setattr(scan, "open_port", lambda name, baudrate, timeout_s: Uart(far[name], baudrate))
    return far


def as_heard(data: bytes, sent_baud: int, own_baud: int) -> bytes:
    """What a UART at its own rate makes of bytes sent at another: it samples the middle of each bit."""
    if sent_baud == own_baud:
        return data
    bits = "1" + "".join("0" + f"{byte:08b}"[::-1] + "1" for byte in data) + "1" * 30
    edges = [k / sent_baud for k in range(1, len(bits)) if bits[k - 1 : k + 1] == "10"]
    heard, free_s = [], 0.0
    for edge_s in edges:
        if edge_s < free_s:
            continue
        instants_s = [edge_s + (k + 0.5) / own_baud for k in range(1, 9)]
        levels = [bits[min(int(at_s * sent_baud), len(bits) - 1)] for at_s in instants_s]
        heard.append(int("".join(reversed(levels)), 2))
        free_s = edge_s + 9.5 / own_baud
    return bytes(heard)
