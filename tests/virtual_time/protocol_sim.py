"""`sim://NAME`: a simulated device of this process as a port, with the time it lives in.

pyserial finds this module by its name (`serial.protocol_handler_packages`).
"""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

from serial import SerialBase, SerialException

from virtual_time.clock import VirtualClock
from virtual_time.world import SimWire

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer as Buffer


class Serial(SerialBase):
    """The port of one simulated device. Who has it open lives in its time."""

    def open(self) -> None:
        """Takes the port (SerialException if there is none, or it is in use)."""
        self._wire = self._plugged()
        try:
            self._wire.open(self)
        except OSError as error:
            raise SerialException(error.errno, str(error)) from error
        self._member = self._wire.clock.take_part()
        self.is_open = True

    def close(self) -> None:
        """Gives it back."""
        if self.is_open:
            self.is_open = False
            self._wire.close(self)
            self._wire.clock.leave(self._member)

    @property
    def clock(self) -> VirtualClock:
        """The time that the device lives in."""
        return self._plugged().clock

    def _plugged(self) -> SimWire:
        wire = SimWire.plugged.get(str(self.portstr))
        if wire is None:
            raise SerialException(errno.ENOENT, f"no simulated device is plugged in at {self.portstr}")
        return wire

    def _reconfigure_port(self) -> None:
        """Baud rate and parity mean nothing within a process."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return self._wire.waiting(self)

    def read(self, size: int = 1) -> bytes:
        """Up to size bytes, as a port with the same time-out gives them."""
        return self._wire.read(self, size, self.timeout)

    def write(self, data: Buffer, /) -> int:
        """Hands bytes to the device."""
        sent = bytes(data)
        self._wire.write(self, sent)
        return len(sent)
