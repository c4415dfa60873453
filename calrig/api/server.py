"""Connections whose client dawdles: each is answered or cut off in time, and holds little meanwhile.

Uvicorn waits for ever for a request's head, and for a client to read its answer. The time a body may take
is `calrig.api.limits`'s to say. Where there are too many connections, nobody is turned away before it could
say who it is: the one that has the least claim to its place is cut off.

The HTTP server under the application: it says when it is ready, and ends without being waited for.

The address the service listens on, bound before anything slow is started.
"""

from __future__ import annotations

import asyncio
import errno
import json
import socket
import sys
from collections.abc import Callable
from typing import Any

import h11
import uvicorn
from fastapi import FastAPI
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from calrig.api.access import PLACE_KEY, Place, Standing, network_of
from calrig.api.context import context_of
from calrig.api.lingering import LingeringTransport

HEAD_S = 10.0
"""How long a request's head may take to come, from its first byte or the connection's beginning."""
REST_S = 30.0
"""How long the rest of a body may come, and is dropped, after its answer has been sent."""
UNREAD_S = 30.0
"""How long an answer may wait for its client to read the next tens of kilobytes of it."""
UNREAD_BYTES = 50_000_000
"""What all clients together may leave unread; beyond it those waited for longest are cut off."""
SEND_BUFFER = 131_072
"""Bytes that the system holds of what is on its way to a client; left to itself, it holds megabytes."""
MOST = 500
"""Connections at once: files and ports need descriptors too, and many systems give a process 1,024."""
FOR_NEWCOMERS = 100
"""Places of these that nobody keeps: so long does a new connection have until as many others have come."""
STRANGERS_EACH = 64
"""Connections of one address that have shown no token: a browser opens six, and a lab may share an address.

Not of this machine's own address: a proxy in front comes from there with everybody it lets in.
"""
ACCEPTED_AT_ONCE = 16
"""Connections taken before those of the turn before are read from: few, so that these still have places."""


class PatientProtocol(H11Protocol):
    """Uvicorn's HTTP/1.1 with an end to its patience."""

    transport: LingeringTransport

    def __init__(
        self, config: Config, server_state: ServerState, app_state: dict[str, Any], **others: Any
    ) -> None:
        self.place = Place()
        super().__init__(config, server_state, {**app_state, PLACE_KEY: self.place}, **others)
        self._since_s = 0.0
        self._asked: object = None
        self._network: str | None = None
        self._head_or_rest: asyncio.TimerHandle | None = None
        self._unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Takes the connection; where there are too many, in the place of another."""
        super().connection_made(transport)
        self.transport = LingeringTransport(transport, lambda: self.conn.their_state is h11.SEND_BODY)
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self._since_s = self.loop.time()
        self._network = network_of(self.client[0]) if self.client else None
        self._make_room()
        self._look()

    def data_received(self, data: bytes) -> None:
        """As uvicorn's."""
        if self.transport.lingers:
            return
        super().data_received(data)
        self._look()

    def handle_events(self) -> None:
        """As uvicorn's; notes when a request began."""
        super().handle_events()
        if self.cycle is not self._asked:
            self._asked = self.cycle
            self._since_s = self.loop.time()

    def on_response_complete(self) -> None:
        """As uvicorn's."""
        self._since_s = self.loop.time()
        super().on_response_complete()
        self._look()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forgets the clocks."""
        super().connection_lost(exc)
        self.transport.lost()
        for clock in (self._head_or_rest, self._unread):
            if clock is not None:
                clock.cancel()

    def pause_writing(self) -> None:
        """The client leaves tens of kilobytes unread: it has some time, and all together some room."""
        super().pause_writing()
        self._wait_for_reading()
        slow = sorted((c for c in self._patient() if c._unread), key=lambda c: c.unread_until_s)
        unread = sum(c.n_unread for c in slow)
        for other in slow:
            if unread > UNREAD_BYTES and other is not self:
                unread -= other.n_unread
                other.cut_off()

    def resume_writing(self) -> None:
        """The client has read."""
        super().resume_writing()
        if self._unread is not None:
            self._unread.cancel()
            self._unread = None

    def shutdown(self) -> None:
        """As uvicorn's; a client that has its answer is not waited for."""
        if self.transport.lingers:
            self.cut_off()
        else:
            super().shutdown()

    def timeout_keep_alive_handler(self) -> None:
        """Closes an idle connection; for its client to read the last answer it waits no longer than else."""
        super().timeout_keep_alive_handler()
        if self.n_unread:
            self._wait_for_reading()

    @property
    def waits_for_client(self) -> bool:
        """Whether it is the client's turn: to ask, to send the rest of a body, to read what it asked for."""
        if self.cycle is None or self.cycle.response_complete or self._unread is not None:
            return True
        return bool(self.cycle.more_body) and not self.flow.read_paused

    @property
    def keeps_its_place(self) -> bool:
        """Whether it gives way to others of its kind alone.

        Without a token everybody is known, and who is waited for goes first.
        """
        if self.place.standing is Standing.ANYBODY:
            return not self.waits_for_client
        return self.place.standing is Standing.KNOWN

    @property
    def unread_until_s(self) -> float:
        """When a client that does not read is waited for no longer."""
        return self._unread.when() if self._unread else 0.0

    @property
    def n_unread(self) -> int:
        """Bytes that the client has not taken."""
        return self.transport.get_write_buffer_size()

    def cut_off(self) -> None:
        """Ends the connection, whatever is still to be sent."""
        self.transport.abort()

    def _patient(self) -> list[PatientProtocol]:
        return [c for c in self.connections if isinstance(c, PatientProtocol)]

    def _make_room(self) -> None:
        """Cuts off who has the least claim to its place, where there are too many.

        Among those who keep no place, who took the last step longest ago: came, asked, was answered.
        """
        near = [c for c in self._patient() if c._network == self._network] if self._network else []
        if len(self.connections) <= MOST and len(near) <= STRANGERS_EACH:
            return  # as nearly always
        others = [c for c in self._patient() if c is not self and not c.transport.is_gone]
        newcomers = [c for c in others if not c.keeps_its_place]
        near = [c for c in newcomers if c._network == self._network] if self._network else []
        if len(near) >= STRANGERS_EACH:
            min(near, key=lambda c: c._since_s).cut_off()
        elif len(others) < MOST:
            return
        elif len(newcomers) >= FOR_NEWCOMERS:
            min(newcomers, key=lambda c: c._since_s).cut_off()
        else:
            kept = (c for c in others if c.keeps_its_place)
            min(kept, key=lambda c: (not c.waits_for_client, c._since_s)).cut_off()

    def _look(self) -> None:
        """Starts or stops the clock of a head or of a body's rest; one that runs goes on."""
        is_answered = self.cycle is None or self.cycle.response_complete
        if self.transport.is_closing() or not is_answered:
            if self._head_or_rest is not None:
                self._head_or_rest.cancel()
                self._head_or_rest = None
        elif self._head_or_rest is None:
            is_head = self.conn.their_state is h11.IDLE
            self._head_or_rest = self.loop.call_later(
                HEAD_S if is_head else REST_S, self._head_is_late if is_head else self.cut_off
            )

    def _wait_for_reading(self) -> None:
        if self._unread is None:
            self._unread = self.loop.call_later(UNREAD_S, self.cut_off)

    def _head_is_late(self) -> None:
        if self.conn.trailing_data[0] and self.conn.our_state is h11.IDLE:
            self._refuse(408, f"the request's head did not come within {HEAD_S:g} s")
        else:  # a browser that opened it in case it were needed
            self.transport.close()

    def _refuse(self, status: int, reason: str) -> None:
        body = json.dumps({"detail": reason}).encode()
        headers = [("content-type", "application/json"), ("content-length", str(len(body)))]
        head = h11.Response(status_code=status, headers=[*headers, ("connection", "close")])
        for event in (head, h11.Data(data=body), h11.EndOfMessage()):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()


WAITING = 2048
"""Connections that may wait to be taken: one beyond them would try again a second later."""
DRAIN_S = 1
"""How long answers under way may take once the service was told to stop."""
SWITCH_S = 0.0005
"""How long one thread may compute while others wait: a stop passes through several on its way."""


class Server(uvicorn.Server):
    """Uvicorn, which says when it is ready and ends open event streams before it waits for them."""

    def __init__(self, app: FastAPI, on_ready: Callable[[], None] = lambda: None) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http=PatientProtocol,
                proxy_headers=False,  # the application sees to them, and to whose they are
                log_config=None,  # as calrig.logs says
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
        """Starts, then says so."""
        sys.setswitchinterval(SWITCH_S)
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(WAITING)  # asyncio takes as many at once as may wait: those are two numbers
        self._on_ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Ends streams and runs at once, and stops as uvicorn does: no stage moves while answers drain."""
        self._streams.close()
        closing = asyncio.create_task(asyncio.to_thread(self._service.close))
        await super().shutdown(sockets)
        await closing


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
