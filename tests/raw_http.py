"""Connections without a library between: for clients that do what no decent one would."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import httpx


@contextmanager
def connected(
    client: httpx.Client, *, small_window: bool = False, source: str = ""
) -> Iterator[socket.socket]:
    """A connection to the client's service, from another address of this machine where one is given."""
    with socket.socket() as one:
        if small_window:  # so that an answer does not vanish into the system's buffers
            one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        if source:
            one.bind((source, 0))
        one.settimeout(60)
        one.connect((client.base_url.host, client.base_url.port))
        yield one


def head(client: httpx.Client, line: str, *more: str) -> bytes:
    """A request's head."""
    return "\r\n".join([line, f"Host: {client.base_url.host}:{client.base_url.port}", *more, "", ""]).encode()


def everything(one: socket.socket) -> bytes:
    """What comes until the service hangs up."""
    received = b""
    try:
        while piece := one.recv(65536):
            received += piece
    except ConnectionResetError:
        pass
    return received


def has_hung_up(one: socket.socket) -> bool:
    """Whether the service takes nothing any more; a byte is sent to know."""
    try:
        one.sendall(b"x")
    except OSError:
        return True
    return False
