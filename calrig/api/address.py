"""The address the service listens on, bound before anything slow is started."""

from __future__ import annotations

import errno
import socket

BACKLOG = 128


class AddressError(Exception):
    """The address cannot be listened on; the message says why and what to do."""


def listen(host: str, port: int) -> socket.socket:
    """A socket bound to the address.

    Raises:
        AddressError: the port is taken or not allowed, or the host is none of this machine's.
    """
    try:
        return _bound(host, port)
    except socket.gaierror as error:
        raise AddressError(f"{host}: there is no such host ({error.strerror}); use --host") from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            reason = "is in use, perhaps by another `calrig serve`: stop that one or use --port"
        else:
            reason = f"cannot be listened on ({error.strerror}): use --host and --port"
        raise AddressError(f"{host}:{port} {reason}") from error


def _bound(host: str, port: int) -> socket.socket:
    # The protocol is named because asyncio switches Nagle's algorithm off only where it is: with it on, the
    # second packet of every answer waits 40 ms for the client to acknowledge the first.
    places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, proto=socket.IPPROTO_TCP)
    family, kind, protocol, _, address = places[0]
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError:
        listener.close()
        raise
    return listener
