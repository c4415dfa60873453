"""The API within this process, without a port: a command asks it as it asks a service, by `calrig.client`."""

import logging
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from types import ModuleType

import anyio
import httpx
from anyio.from_thread import BlockingPortal, start_blocking_portal
from anyio.streams.memory import MemoryObjectReceiveStream
from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Scope

from calrig.api import errors
from calrig.api.access import ANYBODY, KEY
from calrig.api.context import ApiContext
from calrig.runs.services import Service

ADDRESS = "http://localhost"
"""What requests are addressed to; nothing goes there."""

log = logging.getLogger(__name__)


@contextmanager
def in_process(service: Service, parts: tuple[ModuleType, ...]) -> Iterator[httpx.BaseTransport]:
    """Yield a transport that passes a client's requests, as an admin's, to the API over a service.

    `service` is not closed here. `parts` are modules of `calrig.api` with the routes that are asked for: all
    of them take a second to load.
    """
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    context = app.state.context = ApiContext(service, service.store)
    errors.install(app)
    for part in parts:
        app.include_router(part.router)

    async def end() -> None:
        context.streams.close()
        await context.jobs.close()
        await context.processes.close()

    with start_blocking_portal() as portal:
        try:
            yield InProcess(app, portal)
        finally:
            portal.call(end)
            portal.call(portal.stop, True)


class InProcess(httpx.BaseTransport):
    """Passes requests to an application in an event loop elsewhere, and its answers on as they come.

    `httpx.ASGITransport` holds an answer back until it is whole, so that no event would come in time.
    """

    def __init__(self, app: ASGIApp, portal: BlockingPortal) -> None:
        self._app, self._portal = app, portal

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Sends a request with its whole body; returns once the answer has begun."""
        request.read()
        try:
            exchange = _Exchange(self._portal)
            self._portal.start_task_soon(exchange.carry_out, self._app, request)
            begun = exchange.next()
        except (RuntimeError, CancelledError) as error:  # the portal has ended
            raise httpx.ConnectError("the command has ended") from error
        if begun is None:
            exchange.close()
            raise httpx.ReadError("calrig failed inside")
        return httpx.Response(begun["status"], headers=begun["headers"], stream=exchange)


class _Exchange(httpx.SyncByteStream):
    """A request's messages to and from the application; the stream of its answer's body."""

    def __init__(self, portal: BlockingPortal) -> None:
        self._portal = portal
        self._left = portal.call(anyio.Event)
        self._messages: MemoryObjectReceiveStream[Message]
        self._tell, self._messages = anyio.create_memory_object_stream[Message](0)

    def __iter__(self) -> Iterator[bytes]:
        try:
            while message := self.next():
                yield message.get("body", b"")
                if not message.get("more_body", False):
                    return
        except (RuntimeError, CancelledError) as error:
            raise httpx.ReadError("the command has ended") from error
        raise httpx.ReadError("calrig failed inside")

    def close(self) -> None:
        """Nobody reads the rest of the answer."""
        try:
            self._portal.call(self._leave)
        except (RuntimeError, CancelledError):
            self._messages.close()  # the loop has ended: nobody else is at it

    def next(self) -> Message | None:
        """Returns the next message of the answer, None if the application has failed."""
        return self._portal.call(self._next)

    async def carry_out(self, app: ASGIApp, request: httpx.Request) -> None:
        is_asked = False

        async def receive() -> Message:
            nonlocal is_asked
            if not is_asked:
                is_asked = True
                return {"type": "http.request", "body": request.content}
            await self._left.wait()
            return {"type": "http.disconnect"}

        async with self._tell:
            try:
                await app(_scope(request), receive, self._send)
            except Exception:
                log.exception("%s %s failed", request.method, request.url.path)

    async def _send(self, message: Message) -> None:
        try:
            await self._tell.send(message)
        except anyio.BrokenResourceError as error:
            raise OSError("nobody reads the answer") from error

    async def _next(self) -> Message | None:
        try:
            return await self._messages.receive()
        except anyio.EndOfStream:
            return None

    async def _leave(self) -> None:
        self._left.set()
        self._messages.close()


def _scope(request: httpx.Request) -> Scope:
    return {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "method": request.method,
        "scheme": request.url.scheme,
        "path": request.url.path,
        "raw_path": request.url.raw_path.split(b"?")[0],
        "query_string": request.url.query,
        "root_path": "",
        "headers": [(name.lower(), value) for name, value in request.headers.raw],
        "client": None,
        "server": None,
        "state": {KEY: ANYBODY},
    }
