"""The rig of ../shared/twin in virtual time: calrig's sketch and an MPU-6050 behind a pseudo-terminal."""

from __future__ import annotations

import json
import os
import socket
import subprocess
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from virtual_time.clock import VirtualClock
from virtual_time.world import SimWire

STEP_S = 0.002
"""The twin waits for permission this often, and takes one command each time."""
BOOT_S = 1.5


class Truth(NamedTuple):
    """What the twin reports of itself: the sensor's elevation, and the bytes that the board has sent."""

    elevation_deg: float
    n_sent: int


class Twin:
    """The board switched on, from `with` to its end. As a device of `SimWire` it only gets its share of time.

    Attributes:
        port: its pseudo-terminal, while its cable is plugged in.
    """

    interval_s = 0.005

    def __init__(self, program: Path, elf: Path, folder: Path, clock: VirtualClock, options: str) -> None:
        self.port = str(folder / "board")
        self._clock = clock
        self._time_s = 0.0
        self._began_s = clock.now_s()
        self._permissions, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [program, "-", folder / "stage", elf, self.port, "--boot", str(BOOT_S), *options.split()],
                env=os.environ | {"IN_STEP_FD": str(theirs.fileno())},
                pass_fds=[theirs.fileno()],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        self._await_report()
        self._wire = SimWire(self, "time of the twin", clock)

    def tell(self, command: str) -> Truth:
        """Gives one command of those at the head of twin.c; returns the truth thereafter."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with self._clock.lock:
            self._process.stdin.write(f"{command}\n")
            self._process.stdin.flush()
            self._step()
            truth = json.loads(self._process.stdout.readline())
        return Truth(truth["elevation_deg"], truth["b"]["tx"])

    def truth(self) -> Truth:
        """The truth of now."""
        return self.tell("truth")

    def emit(self) -> bytes:
        """Continues to the present."""
        while self._time_s < self._clock.now_s() - self._began_s:
            self._step()
        return b""

    def receive(self, data: bytes) -> bytes:
        """Nothing comes this way: the host uses the pseudo-terminal."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        self._wire.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._wire.stop()
        self._permissions.close()
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def _step(self) -> None:
        self._permissions.send(b"\0")
        self._await_report()

    def _await_report(self) -> None:
        assert self._permissions.recv(1), "the twin has ended"
        self._time_s += STEP_S
