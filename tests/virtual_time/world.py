"""Simulated devices in this process, in time of their own: `sim://NAME` is the port of each.

pyserial opens it through `protocol_sim`. Nothing here knows whether the port's user lives by the same clock;
`calrig` does, since it takes the time that its port brings along.
"""

from __future__ import annotations

import errno
import math
from collections.abc import Callable
from itertools import count
from typing import ClassVar

import serial

from calrig.simulator.wire import MOST_WAITING_BYTES, Device
from virtual_time.clock import VirtualClock, Waits

serial.protocol_handler_packages.append("virtual_time")  # for `sim://NAME`
SCHEME = "sim://"
ON_ITS_WAY_S = 0.001
"""Between what a device says and its coming: so that time moves on however often a client queries."""
SYSTEM_BYTES = 4095
"""What a terminal holds for a client that does not read, in addition to the device's buffer."""


class SimWire:
    """A device and its port, from `start` until `stop`; one user at a time.

    Attributes:
        url: what a client opens.
        clock: the time that both ends live in.
    """

    plugged: ClassVar[dict[str, SimWire]] = {}
    _numbers = count(1)

    def __init__(
        self,
        device: Device,
        name: str,
        clock: VirtualClock,
        most_waiting_bytes: int = MOST_WAITING_BYTES,
        opened: Callable[[], None] = lambda: None,
    ) -> None:
        self.clock = clock
        self._opened = opened
        self.url = f"{SCHEME}{name}-{next(self._numbers)}"
        self._device = device
        self._most_bytes = most_waiting_bytes + SYSTEM_BYTES
        self._came = bytearray()
        self._readers: Waits = []
        self._wanted = 1
        self._user: object | None = None
        self._is_up = False
        self._due_s = math.inf

    def start(self) -> None:
        """Switches the device on."""
        with self.clock.lock:
            self.plugged[self.url] = self
            self._is_up = True
            self._emit()

    def stop(self) -> None:
        """Pulls it out; may be called twice, and before `start`."""
        with self.clock.lock:
            self._is_up, self._user = False, None
            self.plugged.pop(self.url, None)
            self.clock.end(self._readers)

    def open(self, user: object) -> None:
        """Takes the port for one user (OSError if it is in use)."""
        with self.clock.lock:
            if self._user is not None:
                raise OSError(errno.EBUSY, "in use")
            self._user = user
            self._came.clear()
            self._opened()

    def close(self, user: object) -> None:
        """Gives it back."""
        with self.clock.lock:
            if self._user is user:
                self._user = None
                self.clock.end(self._readers)

    def waiting(self, user: object) -> int:
        """Bytes that can be read at once (OSError where the device is gone)."""
        self._require_up(user)
        return len(self._came)

    def read(self, user: object, size: int, timeout_s: float | None) -> bytes:
        """Up to `size` bytes, waiting for them at most so long (OSError where the device is gone)."""
        clock = self.clock
        deadline_s = None if timeout_s is None else clock.now_s() + timeout_s
        while True:
            with clock.lock:
                self._require_up(user)
                left_s = None if deadline_s is None else deadline_s - clock.now_s()
                if len(self._came) >= size or (left_s is not None and left_s <= 0):
                    data = bytes(self._came[:size])
                    del self._came[:size]
                    return data
                self._wanted = size
                wait = clock.register(self._readers, left_s)
            clock.rest(wait)

    def write(self, user: object, data: bytes) -> None:
        """Hands bytes to the device, which hears them now (OSError where it is gone)."""
        with self.clock.lock:
            self._require_up(user)
            self.hear(data)

    def hear(self, data: bytes) -> None:
        """The device takes what came, and says what it has to."""
        self.say(self._device.receive(data))
        self._emit()

    def say(self, data: bytes) -> None:
        """Sends bytes on their way to the user; without one they go nowhere."""
        if data and self._user is not None:
            self.clock.at(self.clock.now_s() + ON_ITS_WAY_S, lambda: self._come(data))

    def _come(self, data: bytes) -> None:
        """Take bytes for the user; what stays unread for too long is lost."""
        if self._user is None or len(self._came) + len(data) > self._most_bytes:
            return
        self._came += data
        if len(self._came) >= self._wanted:
            self.clock.end(self._readers)

    def _emit(self) -> None:
        if self._is_up:
            self.say(self._device.emit())
            if self._device.interval_s is not None:
                due_s = self.clock.now_s() + self._device.interval_s
                if due_s < self._due_s:
                    self._due_s = due_s
                    self.clock.at(due_s, self._due)

    def _due(self) -> None:
        if self.clock.now_s() >= self._due_s:
            self._due_s = math.inf
            self._emit()

    def _require_up(self, user: object) -> None:
        if not self._is_up or self._user is not user:
            raise OSError(errno.EIO, "the simulated device is gone")
