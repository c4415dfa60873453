"""Connections of slow clients: each is answered or ended in time, and holds little memory meanwhile.

uvicorn waits without limit for a request's head, and for a client to read its answer. A `Connection` stands
between the socket and uvicorn's HTTP protocol: to the socket it is the protocol, to uvicorn the transport.
Each request passes through it on its way to the application, so it knows whether one is in progress.
`calrig.api.body_limits` limits the time of a body.
"""

import asyncio
import json
import socket
from collections.abc import Callable
from typing import Any, cast

import h11
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol

from calrig.api.access import PLACE_KEY, Place, Standing, network_of

HEAD_S = 10.0
"""Maximum time for a request's head, from the connection's beginning or the previous answer."""
REST_S = 30.0
"""Maximum time for the rest of a body after its answer was sent. The rest is dropped."""
LINGER_S = 10.0
"""Maximum time that a closed connection takes and drops data. See `Connection.close`."""
UNREAD_S = 30.0
"""Maximum time for a client to read the next tens of kilobytes of its answer."""
UNREAD_BYTES = 50_000_000
"""Maximum of unread bytes over all clients; beyond it, those that have waited longest are cut off."""
SEND_BUFFER = 131_072
"""Bytes that the system buffers for a client; its default is megabytes."""
MOST = 500
"""Maximum number of connections: files and ports need descriptors too, often limited to 1,024 a process."""
FOR_NEWCOMERS = 100
"""Connections among these that may be replaced: a new one lasts until as many others have come."""
STRANGERS_EACH = 64
"""Connections of one address without a token: a browser opens six, and a laboratory may share an address.

Loopback is exempt: all clients of a proxy on this machine come from there.
"""


class Connections:
    """All connections of a server, and the ASGI application that notes each request on its connection."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self.open: set[Connection] = set()
        self.unread: dict[Connection, asyncio.TimerHandle] = {}
        """Connections whose client leaves an answer unread, in the order in which they are cut off."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Call the application and tell the request's connection how far it is."""
        if scope["type"] == "http":
            await scope["state"][PLACE_KEY].answer(self.app, scope, receive, send)
        else:
            await self.app(scope, receive, send)

    def end_lingering(self) -> None:
        """Cut off the clients that already have their answer."""
        for one in [c for c in self.open if c.is_lingering]:
            one.abort()


class Connection(Place, asyncio.Protocol):
    """Limit how long and how much one client can hold; what comes and goes passes through to uvicorn.

    `config` is of a server whose application is a `Connections`; each request gets `app_state`.
    """

    _transport: asyncio.Transport

    def __init__(self, config: Config, app_state: dict[str, Any], **others: Any) -> None:
        super().__init__()
        self._http = H11Protocol(config, app_state={**app_state, PLACE_KEY: self}, **others)
        self._all = cast(Connections, config.app)
        self._loop = asyncio.get_running_loop()
        self._since_s = self._loop.time()
        self._network: str | None = None
        self._deadline: asyncio.TimerHandle | None = None  # of a head, of a body's rest, of lingering
        self._request: object = None
        self._awaits_body = self._has_begun = self._is_late = self.is_lingering = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection; if there are too many, replace another one."""
        self._transport = cast(asyncio.Transport, transport)
        self.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        client = self.get_extra_info("peername")
        self._network = network_of(client[0]) if client else None
        self._all.open.add(self)
        self._http.connection_made(cast(asyncio.Transport, self))
        self._make_room()
        self._end_in(HEAD_S, self._end_late_head)

    def data_received(self, data: bytes) -> None:
        """Pass data on; drop it once the connection lingers."""
        if not self.is_lingering:
            self._has_begun = True
            self._http.data_received(data)

    def eof_received(self) -> None:
        """Pass the client's end of transmission on; asyncio then closes the connection."""
        self._http.eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """Pass the loss on and cancel the clocks."""
        self._http.connection_lost(exc)
        self._all.open.discard(self)
        self._end_in(0, None)
        self._end_unread()

    def pause_writing(self) -> None:
        """Limit the time of a client that leaves tens of kilobytes unread, and the memory of all of them."""
        self._http.pause_writing()
        self._begin_unread()
        unread = sum(c.get_write_buffer_size() for c in self._all.unread)
        for other in self._all.unread:
            if unread > UNREAD_BYTES and other is not self:
                unread -= other.get_write_buffer_size()
                other.abort()

    def resume_writing(self) -> None:
        """End the limit, because the client has read; restart it for what a closed connection still sends."""
        self._http.resume_writing()
        self._end_unread()
        if self._transport.is_closing():
            self._begin_unread()

    def __getattr__(self, name: str) -> Any:
        """Return what a transport has and what is not defined below."""
        return getattr(self._transport, name)

    def is_closing(self) -> bool:
        """Return whether nothing more can be sent."""
        return self.is_lingering or self._transport.is_closing()

    def write(self, data: bytes) -> None:
        """Send data, unless the connection lingers; what asyncio closes still takes it into its buffer."""
        if not self.is_lingering:
            self._transport.write(data)

    def close(self) -> None:
        """Send what is still to be sent, then close; if the client is sending, drop what comes for a while.

        Closed at once, further data would be met with a reset, and a reset discards an answer that the client
        has not read.
        """
        if self.is_closing():
            return
        if self._expects_more:
            self.is_lingering = True
            self._end_in(LINGER_S, self.abort)
            self._transport.resume_reading()
            self._transport.write_eof()
        else:
            self._transport.close()
            if self.get_write_buffer_size():
                self._begin_unread()

    async def answer(self, app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> None:
        """Have the application answer a request; note when the client has to act and when the answer ends."""

        async def next_piece() -> Message:
            self._awaits_body = self._expects_more
            try:
                return await receive()
            finally:
                self._awaits_body = False

        async def noted(message: Message) -> None:
            is_last = message["type"] == "http.response.body" and not message.get("more_body", False)
            await send(message)
            if is_last:
                self._end_answer(request)

        self._request = request = object()
        self._since_s = self._loop.time()
        if not self.is_lingering:
            self._end_in(0, None)
        try:
            await app(scope, next_piece, noted)
        finally:
            self._end_answer(request)

    def _end_answer(self, request: object) -> None:
        if self._request is not request:  # ended before; the next request may have begun
            return
        self._request = None
        self._has_begun = False
        self._since_s = self._loop.time()
        if not self.is_closing():
            if self._expects_more:
                self._end_in(REST_S, self.abort)
            else:
                self._end_in(HEAD_S, self._end_late_head)

    @property
    def _expects_more(self) -> bool:
        """Whether the client is in the midst of a request."""
        return self._is_late or self._http.conn.their_state is h11.SEND_BODY

    @property
    def waits_for_client(self) -> bool:
        """Whether the client has to act: to ask, to send the rest of a body, to read its answer."""
        return self._request is None or self._awaits_body or self in self._all.unread

    @property
    def keeps_its_place(self) -> bool:
        """Whether only connections of its kind replace it.

        Without a token every client is known; those that the service waits for are replaced first.
        """
        if self.standing is Standing.ANYBODY:
            return not self.waits_for_client
        return self.standing is Standing.KNOWN

    def _make_room(self) -> None:
        """Cut off the connection with the least claim to its place, if there are too many.

        Of those that keep no place, it is the one that connected, asked or was answered longest ago.
        """
        near = [c for c in self._all.open if c._network == self._network] if self._network else []
        if len(self._all.open) <= MOST and len(near) <= STRANGERS_EACH:
            return  # nearly always
        others = [
            c
            for c in self._all.open
            if c is not self and (c.get_write_buffer_size() or not c._transport.is_closing())
        ]
        newcomers = [c for c in others if not c.keeps_its_place]
        near = [c for c in newcomers if c._network == self._network] if self._network else []
        if len(near) >= STRANGERS_EACH:
            min(near, key=lambda c: c._since_s).abort()
        elif len(others) < MOST:
            return
        elif len(newcomers) >= FOR_NEWCOMERS:
            min(newcomers, key=lambda c: c._since_s).abort()
        else:
            kept = (c for c in others if c.keeps_its_place)
            min(kept, key=lambda c: (not c.waits_for_client, c._since_s)).abort()

    def _end_in(self, seconds: float, end: Callable[[], None] | None) -> None:
        """Replace the deadline; `None` removes it.

        A request that has come by the deadline begins first, and removes it: else one that is carried out
        would be answered by 408. Its task takes one more turn of a busy event loop.
        """

        def at_deadline(end: Callable[[], None]) -> None:
            self._deadline = self._loop.call_later(0, end)

        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = self._loop.call_later(seconds, at_deadline, end) if end else None

    def _begin_unread(self) -> None:
        if self not in self._all.unread:
            self._all.unread[self] = self._loop.call_later(UNREAD_S, self.abort)

    def _end_unread(self) -> None:
        if clock := self._all.unread.pop(self, None):
            clock.cancel()

    def _end_late_head(self) -> None:
        if self._has_begun:  # else a browser opened the connection in case it were needed
            body = json.dumps({"detail": f"the request's head did not come within {HEAD_S:g} s"}).encode()
            self.write(
                b"HTTP/1.1 408 Request Timeout\r\nconnection: close\r\ncontent-type: application/json\r\n"
                b"content-length: %d\r\n\r\n%s" % (len(body), body)
            )
            self._is_late = True
        self.close()
