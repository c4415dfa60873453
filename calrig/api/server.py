"""The HTTP server: it listens before anything slow starts, reports when it is ready, and stops in time."""

import asyncio
import ctypes
import errno
import socket
import sys
from collections.abc import Callable
from typing import Any

import uvicorn
from fastapi import FastAPI

from calrig.api.connections import Connection, Connections
from calrig.api.context import context_of

ACCEPTED_AT_ONCE = 16
"""Connections accepted before earlier ones are read from: few, so that a crowd cannot replace these."""
WAITING = 2048
"""Connections that may wait to be accepted: a client beyond them would retry only a second later."""
KEEP_ALIVE_S = 5
"""How long an idle connection stays open after an answer."""
DRAIN_S = 1
"""Maximum time for answers in progress once the service is to stop."""
SWITCH_S = 0.0005
"""How long one thread may compute while others wait: a stop request passes through several threads."""
M_MMAP_THRESHOLD, LARGE_BYTES = -3, 2**15
"""glibc's `mallopt`: blocks from this size on have pages of their own, which go back to the system. Buffers
of ports and of compression would break up the heap, which grew by 50 MB an hour of twenty rigs.
"""
BACKLOG = 128
"""Connections that may wait while the service starts."""
_Place = tuple[socket.AddressFamily, socket.SocketKind, int, tuple[Any, ...]]


class Server(uvicorn.Server):
    """uvicorn's server; it reports when it is ready, and ends event streams before it waits for them."""

    def __init__(self, app: FastAPI, on_ready: Callable[[], None] = lambda: None) -> None:
        self._connections = Connections(app)
        super().__init__(
            uvicorn.Config(
                self._connections,
                http=Connection,
                timeout_keep_alive=KEEP_ALIVE_S,
                proxy_headers=False,  # `TrustedProxies` of the application sees to them
                log_config=None,  # `calrig.logs` configures logging
                log_level="warning",
                access_log=False,
                timeout_graceful_shutdown=DRAIN_S,
                backlog=ACCEPTED_AT_ONCE,
                ws="none",
            )
        )
        context = context_of(app)
        self._streams, self._service = context.streams, context.service
        self._on_ready = on_ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, then report it."""
        sys.setswitchinterval(SWITCH_S)
        if (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)) is not None:  # other C libraries lack it
            mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(WAITING)  # asyncio's `backlog` is also how many it accepts at once
        self._on_ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams and runs at once, then stop as uvicorn does: no stage moves while answers drain."""
        self._streams.close()
        self._connections.end_lingering()
        closing = asyncio.create_task(asyncio.to_thread(self._service.close))
        await super().shutdown(sockets)
        await closing


class AddressError(Exception):
    """calrig cannot listen on the address; the message says why and what to do."""


def address_of(host: str, port: int) -> str:
    """Return the address that `listen` would bind to.

    Raises:
        AddressError: there is no such host.
    """
    return str(_place(host, port)[-1][0])


def listen(host: str, port: int) -> socket.socket:
    """Return a socket bound to the address.

    Raises:
        AddressError: the port is in use or not allowed, or the host is not an address of this machine.
    """
    try:
        return _bound(host, port)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            reason = "is in use, perhaps by another `calrig serve`: stop that one or use --port"
        else:
            reason = f"cannot be listened on ({error.strerror}): use --host and --port"
        raise AddressError(f"{host}:{port} {reason}") from error


def _place(host: str, port: int) -> _Place:
    # asyncio disables Nagle's algorithm only on sockets whose protocol is given. The algorithm delays the
    # second packet of every answer by 40 ms, until the client has acknowledged the first.
    try:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, proto=socket.IPPROTO_TCP)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise AddressError(f"{host}: there is no such host ({reason}); use --host") from error
    family, kind, protocol, _, address = places[0]
    return family, kind, protocol, address


def _bound(host: str, port: int) -> socket.socket:
    family, kind, protocol, address = _place(host, port)
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError:
        listener.close()
        raise
    return listener
