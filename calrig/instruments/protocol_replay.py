"""`replay://FILE`: a transcript as a port, so that a conversation with a device can be repeated.

pyserial finds this module by its name (`serial.protocol_handler_packages`). What the device sent is given out
as soon as calrig has sent what it had sent then, without the pauses in between. Each command is answered as
it was the next time it was sent in the transcript, or the last time if it was sent less often then. A command
that was never sent is not answered.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from serial import SerialBase, SerialException

from calrig.instruments.transcript import Piece, read_transcript

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer as Buffer

SCHEME = "replay://"


class Serial(SerialBase):
    """A port that answers from a transcript."""

    def open(self) -> None:
        """Reads the transcript (SerialException where it cannot be)."""
        path = Path(str(self.portstr).removeprefix(SCHEME))
        try:
            with path.open(encoding="ascii") as lines:
                self._script = _exchanges(read_transcript(lines))
        except (OSError, ValueError) as error:
            raise SerialException(f"transcript {path}: {error}") from error
        self._place = 0
        self._came = bytearray(self._script[0][1])
        self._news = threading.Condition()
        self.is_open = True

    def close(self) -> None:
        """Ends the replay."""
        self.is_open = False

    def _reconfigure_port(self) -> None:
        """Baud rate and parity mean nothing to a file."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return len(self._came)

    def read(self, size: int = 1) -> bytes:
        """Up to size bytes, as a port with the same time-out gives them."""
        deadline = None if self.timeout is None else time.monotonic() + self.timeout
        with self._news:
            while len(self._came) < size:
                left = None if deadline is None else deadline - time.monotonic()
                if (left is not None and left <= 0) or not self._news.wait(left):
                    break
            data = bytes(self._came[:size])
            del self._came[:size]
        return data

    def write(self, data: Buffer, /) -> int:
        """Takes a command and has it answered."""
        sent = bytes(data)
        with self._news:
            place = self._next(sent)
            if place is not None:
                self._place = max(self._place, place)
                self._came += self._script[place][1]
                self._news.notify_all()
        return len(sent)

    def _next(self, sent: bytes) -> int | None:
        later = range(self._place + 1, len(self._script))
        earlier = range(self._place, 0, -1)
        return next((k for k in (*later, *earlier) if self._script[k][0] == sent), None)


def _exchanges(pieces: list[Piece]) -> list[tuple[bytes, bytes]]:
    """What was sent with what came until the next was sent; the first with nothing sent."""
    script = [(b"", b"")]
    for piece in pieces:
        if piece.direction == ">":
            script.append((piece.data, b""))
        else:
            sent, came = script[-1]
            script[-1] = sent, came + piece.data
    return script
