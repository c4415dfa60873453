"""Joins a device to its port: one thread each, so that neither device waits for the other's reader."""

from __future__ import annotations

import threading
from typing import Protocol

from calrig.simulator.ports import Port

MOST_WAITING_BYTES = 1 << 16
"""What a reader who does not keep up has coming; blocks beyond it are lost, as in any UART."""
RETRY_S = 0.005


class Device(Protocol):
    """Speaks a dialect. Called by one thread at a time."""

    @property
    def interval_s(self) -> float | None:
        """Wall time until it may speak unasked; None while it only answers."""

    def receive(self, data: bytes) -> bytes:
        """Takes what came; returns the answer."""

    def emit(self) -> bytes:
        """What it has to say unasked, in whole messages."""


class Wire:
    """A device on a port, from `start` until `stop`."""

    def __init__(
        self, device: Device, port: Port, name: str, most_waiting_bytes: int = MOST_WAITING_BYTES
    ) -> None:
        self._device = device
        self._most_waiting_bytes = most_waiting_bytes
        self._port = port
        self._waiting = b""
        self._stopping = False
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)

    @property
    def url(self) -> str:
        """What a client opens."""
        return self._port.url

    def start(self) -> None:
        """Begins to listen."""
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread and closes the port; may be called twice, and before `start`."""
        if self._stopping:
            return
        self._stopping = True
        if self._thread.is_alive():
            self._port.wake()
            self._thread.join()
        self._port.close()

    def _serve(self) -> None:
        while not self._stopping:
            received = self._port.wait(RETRY_S if self._waiting else self._device.interval_s)
            if received:
                self._say(self._device.receive(received))
            self._say(self._device.emit())

    def _say(self, data: bytes) -> None:
        if len(self._waiting) + len(data) <= self._most_waiting_bytes:
            self._waiting += data
        if self._waiting:
            self._waiting = self._waiting[self._port.write(self._waiting) :]
