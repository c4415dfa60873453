"""The address the service listens on, bound before anything slow is started."""

from __future__ import annotations

import errno
import socket
from typing import Any

BACKLOG = 128
_Place = tuple[socket.AddressFamily, socket.SocketKind, int, tuple[Any, ...]]


class AddressError(Exception):
    """The address cannot be listened on; the message says why and what to do."""


def address_of(host: str, port: int) -> str:
    """The address that `listen` would bind to.

    Raises:
        AddressError: there is no such host.
    """
    return str(_place(host, port)[-1][0])


def listen(host: str, port: int) -> socket.socket:
    """A socket bound to the address.

    Raises:
        AddressError: the port is taken or not allowed, or the host is none of this machine's.
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
    # The protocol is named because asyncio switches Nagle's algorithm off only where it is: with it on, the
    # second packet of every answer waits 40 ms for the client to acknowledge the first.
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
