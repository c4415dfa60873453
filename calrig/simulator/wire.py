"""A device on a port of the system: a pseudo-terminal, or a TCP port where there is none.

One thread serves each device, so that no device waits for the reader of another.
"""

import contextlib
import os
import selectors
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Literal, Protocol

try:
    import pty
    import tty
except ImportError:  # a system without pseudo-terminals
    PTY_AVAILABLE = False
else:
    PTY_AVAILABLE = True

READ_SIZE = 4096
LOOPBACK = "127.0.0.1"


class Port(ABC):
    """One end of a wire. `url` is what the other end opens."""

    url: str

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._ear, self._mouth = socket.socketpair()
        self._ear.setblocking(False)
        self._selector.register(self._ear, selectors.EVENT_READ)

    def _ready(self, timeout_s: float | None) -> list[object]:
        ready = [key.fileobj for key, _ in self._selector.select(timeout_s)]
        if self._ear in ready:
            self._ear.recv(READ_SIZE)
            ready.remove(self._ear)
        return list(ready)

    @abstractmethod
    def wait(self, timeout_s: float | None) -> bytes:
        """What came, waiting for it at most so long; returns early, with nothing, when woken."""

    @abstractmethod
    def write(self, data: bytes) -> int:
        """Hands over as much as is taken without waiting; returns how much that was."""

    def wake(self) -> None:
        """Ends a `wait` from another thread."""
        self._mouth.send(b"!")

    def close(self) -> None:
        """Closes the port."""
        self._selector.close()
        self._ear.close()
        self._mouth.close()


class PtyPort(Port):
    """A pseudo-terminal in raw mode.

    Its far end is kept open here too: a client that closes then leaves no error behind, and what it set on
    the line stays as on a real port.
    """

    def __init__(self) -> None:
        super().__init__()
        self._near, self._far = pty.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        self.url = os.ttyname(self._far)
        self._selector.register(self._near, selectors.EVENT_READ)

    def wait(self, timeout_s: float | None) -> bytes:
        """What came, waiting for it at most so long."""
        return os.read(self._near, READ_SIZE) if self._ready(timeout_s) else b""

    def write(self, data: bytes) -> int:
        """Hands over as much as the terminal's buffer takes."""
        try:
            return os.write(self._near, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Closes both ends."""
        super().close()
        os.close(self._near)
        os.close(self._far)


class TcpPort(Port):
    """A TCP port on this machine, for pyserial's `socket://`. A new client takes the place of the last.

    `opened` is called whenever one comes, in the thread that waits.
    """

    def __init__(self, opened: Callable[[], None]) -> None:
        super().__init__()
        self._opened = opened
        self._server = socket.create_server((LOOPBACK, 0))
        self._server.setblocking(False)
        self._selector.register(self._server, selectors.EVENT_READ)
        self._client: socket.socket | None = None
        self.url = f"socket://{LOOPBACK}:{self._server.getsockname()[1]}"

    def wait(self, timeout_s: float | None) -> bytes:
        """What came, waiting for it at most so long."""
        ready = self._ready(timeout_s)
        if self._server in ready:
            self._accept()
        if self._client is None or self._client not in ready:
            return b""
        try:
            data = self._client.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        except ConnectionError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> int:
        """Hands over as much as the connection takes; without a client it goes nowhere, as on a wire."""
        if self._client is None:
            return len(data)
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except ConnectionError:
            self._hang_up()
            return len(data)

    def close(self) -> None:
        """Closes the connection and the port."""
        self._hang_up()
        super().close()
        self._server.close()

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):  # it hung up before it was let in
            client, _ = self._server.accept()
            self._hang_up()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._selector.register(client, selectors.EVENT_READ)
            self._client = client
            self._opened()

    def _hang_up(self) -> None:
        if self._client is not None:
            self._selector.unregister(self._client)
            self._client.close()
            self._client = None


def open_port(kind: Literal["auto", "pty", "tcp"], opened: Callable[[], None] = lambda: None) -> Port:
    """A port of this kind; `auto` is a pseudo-terminal where the system has them.

    `opened` is called whenever a client opens it; a pseudo-terminal does not tell.

    Raises:
        ValueError: pseudo-terminals were asked for and there are none.
    """
    if kind == "tcp" or (kind == "auto" and not PTY_AVAILABLE):
        return TcpPort(opened)
    if not PTY_AVAILABLE:
        raise ValueError("ports: this system has no pseudo-terminals; use `tcp`")
    return PtyPort()


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
    """A device on a port, from `start` until `stop`; `url` is what a client opens."""

    def __init__(
        self, device: Device, port: Port, name: str, most_waiting_bytes: int = MOST_WAITING_BYTES
    ) -> None:
        self._device = device
        self._most_waiting_bytes = most_waiting_bytes
        self._port = port
        self.url = port.url
        self._waiting = b""
        self._stopping = False
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)

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
