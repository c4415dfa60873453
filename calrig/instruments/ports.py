"""Opening and using a port: anything `serial.serial_for_url` takes, every failure said with its name."""

import errno
import os
import select
import socket

import serial
from serial.tools import list_ports

from calrig.instruments.clock import WALL, Clock
from calrig.instruments.errors import PortBlocked, PortError
from calrig.instruments.transcript import Tape, tape_of

serial.protocol_handler_packages.append("calrig.instruments")  # for `replay://FILE`
WRITE_TIMEOUT_S = 0.5
USB = "usb:"
"""Before the serial number of a USB adapter: which name the system gave it does not matter then."""

_WHAT_TO_DO = {
    errno.ENOENT: "does not exist: is it plugged in? `python -m serial.tools.list_ports` lists all there are",
    errno.EACCES: (
        "may not be opened by this user: join the group that owns it "
        "(usually `sudo usermod -aG dialout $USER`) and log in again"
    ),
    errno.EBUSY: "is in use by another program: close that program first",
}
_SAME_AS = {
    errno.ENODEV: errno.ENOENT,
    errno.ENXIO: errno.ENOENT,
    errno.EPERM: errno.EACCES,
    errno.EWOULDBLOCK: errno.EBUSY,
}


class Port:
    """An open port. Whatever fails on it is a PortError that names it.

    One thread may read while another writes; two threads that write need a lock of their own.

    Attributes:
        name: as it was asked for.
        clock: the time that what hangs on it lives in.
    """

    def __init__(self, name: str, wire: serial.Serial, tape: Tape | None = None) -> None:
        self.name = name
        self.clock = _clock_of(wire)
        self._wire = wire
        self._tape = tape
        self._descriptor = _descriptor_of(wire)

    def read(self, size: int) -> bytes:
        """Up to `size` bytes: returns when they are there, or with those that came within the time-out."""
        try:
            data = bytes(self._wire.read(size))
        except OSError as error:
            raise self._gone("reading", error) from error
        if data and self._tape is not None:
            self._tape.note("<", data)
        return data

    def read_some(self) -> bytes:
        """What is there, or the first byte that comes within the time-out, or nothing."""
        return self.read(max(1, self.waiting()))

    def waiting(self) -> int:
        """Return how many bytes can be read at once; on `socket://` 1 means any number."""
        try:
            return int(self._wire.in_waiting)
        except OSError as error:
            raise self._gone("reading", error) from error

    def write(self, data: bytes) -> None:
        """Hands all bytes to the system, which sends them."""
        if self._tape is not None:
            self._tape.note(">", data)  # before the answer can come
        try:
            if self._descriptor is None:
                self._wire.write(data)
            else:
                self._hand_over(data, self._descriptor)
        except serial.SerialTimeoutException as error:
            raise PortBlocked(
                f"port {self.name} took nothing for {WRITE_TIMEOUT_S:g} s: is the device switched on, "
                "and is flow control off?"
            ) from error
        except OSError as error:
            raise self._gone("writing", error) from error

    def _hand_over(self, data: bytes, descriptor: int) -> None:
        # pyserial looks at the clock before it looks at the port: a thread that a busy machine kept waiting
        # for so long would get a time-out for a port that had taken all.
        self._require_open()
        until_s = self.clock.now_s() + WRITE_TIMEOUT_S
        left = memoryview(data)
        while left:
            _, ready, _ = select.select([], [descriptor], [], max(0.0, until_s - self.clock.now_s()))
            self._require_open()  # after a close the descriptor may belong to another file
            if not ready:
                raise serial.SerialTimeoutException
            try:
                left = left[os.write(descriptor, left) :]
            except BlockingIOError:  # the room was gone again
                if self.clock.now_s() >= until_s:
                    raise serial.SerialTimeoutException from None

    def _require_open(self) -> None:
        if not self._wire.is_open:
            raise serial.PortNotOpenError

    def change_baudrate(self, baudrate: int) -> None:
        """Change the rate without opening the port again, which would reset most boards."""
        try:
            self._wire.baudrate = baudrate
        except (OSError, ValueError) as error:
            raise PortError(f"port {self.name} cannot be set to {baudrate} baud ({error})") from error

    def close(self) -> None:
        """Close the port; never raises. No other thread may be using it."""
        try:
            self._wire.close()
        except OSError:
            return  # the device is gone, and the descriptor with it: nothing is left to close

    def _gone(self, doing: str, error: OSError) -> PortError:
        return PortError(f"port {self.name} went away while {doing} ({error}): check cable and power")


def open_port(url: str, *, baudrate: int, timeout_s: float) -> Port:
    """Opens a port, 8N1, for this process alone where it is a POSIX tty.

    RTS and DTR are raised as every terminal program does; a pseudo-terminal has none, and pyserial takes its
    ENOTTY for what it is. `rfc2217://` knows no write time-out.

    Args:
        url: `/dev/ttyUSB0`, `COM3`, `socket://host:port`, `rfc2217://host:port`, `replay://FILE`, …, or
            `usb:` and the serial number of a USB adapter, whatever its port is called today.
        baudrate: bits per second; a socket ignores it.
        timeout_s: how long a read waits for what it was asked for.

    Raises:
        PortError: it cannot be opened; says why and what to do.
    """
    device = device_of(url)
    write_timeout_s = None if url.lower().startswith("rfc2217:") else WRITE_TIMEOUT_S
    try:
        wire = serial.serial_for_url(
            device, baudrate=baudrate, timeout=timeout_s, write_timeout=write_timeout_s, exclusive=True
        )
        if url.lower().startswith("socket:"):
            _send_small_writes_at_once(wire)
    except (OSError, ValueError) as error:
        raise PortError(f"port {url} {_reason(error)}") from error
    return Port(url, wire, tape_of(url, _clock_of(wire)))


def clock_of(url: str) -> Clock:
    """The time that a port lives in, whether it can be opened or not."""
    if "://" not in url:
        return WALL
    try:
        return _clock_of(serial.serial_for_url(url, do_not_open=True))
    except (OSError, ValueError):
        return WALL  # opening it says why


def _clock_of(wire: serial.Serial) -> Clock:
    clock: Clock = getattr(wire, "clock", WALL)
    return clock


def device_of(url: str) -> str:
    """The port that a URL means: the same, but for `usb:` the one whose adapter has that serial number.

    Raises:
        PortError: no adapter that is plugged in has it, or several have; names those there are.
    """
    if not url.lower().startswith(USB):
        return url
    wanted, there = url[len(USB) :], list_ports.comports()
    devices = sorted(port.device for port in there if port.serial_number == wanted)
    if len(devices) > 1:
        raise PortError(
            f"port {url} may be any of {', '.join(devices)}, which all have this serial number: "
            "name the port itself instead"
        )
    if not devices:
        known = ", ".join(f"{port.serial_number} ({port.device})" for port in there if port.serial_number)
        raise PortError(
            f"port {url}: no USB adapter with serial number {wanted!r} is plugged in; "
            f"those there are: {known or 'none that has a serial number'}"
        )
    return str(devices[0])


def _descriptor_of(wire: serial.Serial) -> int | None:
    """Of a port that the system itself knows by one: a POSIX tty or socket."""
    try:
        return int(wire.fileno()) if os.name == "posix" else None
    except OSError:  # `rfc2217://`, `replay://`, …
        return None


def _send_small_writes_at_once(wire: serial.Serial) -> None:
    # A stop must not wait in Nagle's buffer for the acknowledgement of the query before it.
    with socket.fromfd(wire.fileno(), socket.AF_INET, socket.SOCK_STREAM) as same:
        same.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _reason(error: Exception) -> str:
    number = getattr(error, "errno", None)
    known = _WHAT_TO_DO.get(_SAME_AS.get(number, number)) if isinstance(number, int) else None
    if known:
        return known
    cause = error.__context__  # pyserial's sockets keep the number of what failed only here
    if isinstance(cause, ConnectionRefusedError):
        return "refused the connection: is the serial server running, and is that its port number?"
    if isinstance(cause, (socket.gaierror, TimeoutError)):
        return f"cannot be reached ({cause}): check host name and network"
    return f"cannot be opened ({error})"
