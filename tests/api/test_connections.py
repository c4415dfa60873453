"""One connection's deadlines, on an event loop whose time is given."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator
from contextlib import closing

import pytest
import uvicorn
from uvicorn.server import ServerState

from calrig.api.connections import HEAD_S, LINGER_S, Connection, Connections

TURNS = 20
POST = b"POST / HTTP/1.1\r\nHost: here\r\n"


class GivenTime(asyncio.SelectorEventLoop):
    """An event loop whose clock stands until somebody sets it."""

    now_s = 1000.0

    def time(self) -> float:
        return self.now_s

    def turns(self) -> None:
        """Let it do what is to be done by now."""
        for _ in range(TURNS):
            self.run_until_complete(asyncio.sleep(0))


class Client:
    """The client's end of a connection to an application that answers 200 and reads no body."""

    def __init__(self, loop: GivenTime, ours: socket.socket, theirs: socket.socket) -> None:
        self.loop, self.asked = loop, 0
        self._ours = ours
        self.connections = Connections(self._answer)
        config = uvicorn.Config(self.connections, http=Connection, proxy_headers=False, log_config=None)
        config.load()

        def protocol() -> Connection:
            return Connection(config, app_state={}, server_state=ServerState())

        loop.run_until_complete(loop.connect_accepted_socket(protocol, theirs))
        loop.turns()

    async def _answer(self, scope, receive, send) -> None:
        self.asked += 1
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"0")]})
        await send({"type": "http.response.body"})

    def send(self, data: bytes) -> None:
        self._ours.sendall(data)

    def received(self) -> bytes:
        """What has come by now; ends with `<end>` where the service has hung up."""
        self.loop.turns()
        parts = []
        while True:
            try:
                parts.append(self._ours.recv(65536) or b"<end>")
            except BlockingIOError:
                return b"".join(parts)
            if parts[-1] == b"<end>":
                return b"".join(parts)


@pytest.fixture
def client() -> Iterator[Client]:
    ours, theirs = socket.socketpair()
    with closing(GivenTime()) as loop, ours, theirs:
        ours.setblocking(False)
        theirs.setblocking(False)
        yield Client(loop, ours, theirs)


def test_a_head_that_comes_while_the_service_is_busy_beyond_the_deadline_is_answered_as_asked(client):
    """A request that is carried out is not answered by 408: it may have moved a stage."""
    client.send(POST + b"\r\n")
    client.loop.now_s += HEAD_S + 1.0
    assert client.received().startswith(b"HTTP/1.1 200 ")
    assert client.asked == 1


def test_a_head_that_is_not_whole_by_the_deadline_is_408_and_never_carried_out(client):
    client.send(POST)
    assert client.received() == b""
    client.loop.now_s += HEAD_S + 1.0
    assert client.received().startswith(b"HTTP/1.1 408 ")
    client.send(b"\r\n")
    client.loop.now_s += LINGER_S + 1.0
    assert client.received() == b"<end>"
    assert client.asked == 0


@pytest.mark.parametrize("body", [b"", b"{}"])
def test_a_body_that_no_route_reads_leaves_nothing_to_wait_for(client, body):
    client.send(POST + b"Content-Length: %d\r\n\r\n%s" % (len(body), body))
    assert client.received().startswith(b"HTTP/1.1 200 ")
    (connection,) = client.connections.open
    connection.close()
    assert client.received().endswith(b"<end>")
    assert not client.connections.open


def test_a_closed_connection_takes_what_a_client_still_sends_of_its_body(client):
    client.send(POST + b"Content-Length: 90\r\n\r\n{")
    assert client.received().startswith(b"HTTP/1.1 200 ")
    (connection,) = client.connections.open
    connection.close()
    assert connection.is_lingering
    client.send(b"x" * 10)
    client.loop.now_s += LINGER_S + 1.0
    client.received()
    assert not client.connections.open
