"""The controller's serial line: bytes come and go at its rate, and 128 of them wait to be read (serial.c)."""

from __future__ import annotations

import math
from collections import deque

BYTE_S = 10 / 115200
MOST_WAITING = 128
MOST_SENDING = 104
"""What the send buffer holds; the firmware waits while it is full."""


class Uart:
    """Both directions, in the controller's time.

    Attributes:
        waiting: what has come and was not read yet; what comes while it is full is lost.
    """

    def __init__(self) -> None:
        self.waiting: deque[int] = deque()
        self._coming: deque[tuple[float, int]] = deque()
        self._going: deque[tuple[float, bytes]] = deque()
        self._heard_s = self._said_s = 0.0

    def feed(self, at_s: float, data: bytes) -> float:
        """Take bytes from the host; return when the last one will have come."""
        self._heard_s = max(self._heard_s, at_s)
        for byte in data:
            self._heard_s += BYTE_S
            self._coming.append((self._heard_s, byte))
        return self._heard_s

    @property
    def next_s(self) -> float:
        """When the next byte comes; infinite where none is on its way."""
        return self._coming[0][0] if self._coming else math.inf

    def take(self, at_s: float) -> bytes:
        """What has come by now, for the receive interrupt."""
        came = bytearray()
        while self._coming and self._coming[0][0] <= at_s:
            came.append(self._coming.popleft()[1])
        return bytes(came)

    def keep(self, byte: int) -> None:
        """Put a byte among those that wait."""
        if len(self.waiting) < MOST_WAITING:
            self.waiting.append(byte)

    def say(self, at_s: float, data: bytes) -> float:
        """Begin to send; return when there is room in the send buffer again."""
        self._said_s = max(self._said_s, at_s) + len(data) * BYTE_S
        self._going.append((self._said_s, data))
        return self._said_s - MOST_SENDING * BYTE_S

    def said(self, at_s: float) -> bytes:
        """What has gone out by now."""
        gone = bytearray()
        while self._going and self._going[0][0] <= at_s:
            gone += self._going.popleft()[1]
        return bytes(gone)

    @property
    def is_sending(self) -> bool:
        """Whether something is still to go out."""
        return bool(self._going)
