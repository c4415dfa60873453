"""Limits of request bodies: how slowly they may come, and how many uploads are in progress at once.

FastAPI limits their size (`max_body_size` of the paths), but not their time, and answers in plain text. Here
a body that comes too slowly gets 408, one upload too many 503, and FastAPI's 413 becomes JSON.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from shutil import copyfileobj
from tempfile import NamedTemporaryFile
from typing import IO

from fastapi import UploadFile
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from calrig.api.access import CLOSE
from calrig.api.errors import no_room

JSON_BYTES = 1_000_000
LOGIN_BYTES = 10_000
"""Limit for requests without authentication, which are held in memory for every connection."""
POSES_BYTES = LOG_BYTES = 150_000_000
"""100 MB in any unit, with a margin: two million samples of seven columns."""
LOGIN_PATH = "/api/login"
ENROLL_PATH = "/api/benches/enroll"
UPLOADS = {"/api/imports": POSES_BYTES, "/api/noise": LOG_BYTES, "/api/filters": LOG_BYTES}
MOST_UPLOADS = 16
"""Uploads in progress at once. Each may occupy a temporary file until it is processed."""
GRACE_S = 10.0
SLOWEST_BYTES_PER_S = 20_000
"""A body may take `GRACE_S`, plus one second per so many bytes received."""

LONGEST_NAME = 200


class BodyPatience:
    """ASGI middleware that ends slow bodies and excess uploads."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._uploads: set[_Body] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on with a `receive` that has a deadline."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        is_upload = scope["path"] in UPLOADS
        body = _Body(receive)
        if is_upload and not self._has_room():
            reason = f"{MOST_UPLOADS} uploads are in progress: try again later"
            await JSONResponse({"detail": reason}, 503, {"Retry-After": "5"})(scope, receive, send)
            return
        if is_upload:
            self._uploads.add(body)
        try:
            await self.app(scope, body.receive, body.answering(scope, send))
        finally:
            self._uploads.discard(body)

    def _has_room(self) -> bool:
        """Return whether one more upload is accepted; if there are too many, the slowest one is ended."""
        if len(self._uploads) < MOST_UPLOADS:
            return True
        coming = [upload for upload in self._uploads if upload.is_coming]
        if coming:
            min(coming, key=lambda upload: upload.bytes_per_s).give_way()
        return bool(coming)


class _Body:
    """The incoming body of one request, and the beginning of its answer."""

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._n_bytes = 0
        self._waited_s = 0.0
        self._waiting: asyncio.Timeout | None = None
        self._has_ended = False
        self._is_answered = False

    def answering(self, scope: Scope, send: Send) -> Send:
        """Return a `send` that notes the beginning of the answer and turns FastAPI's 413 into JSON."""
        too_large = False

        async def noted(message: Message) -> None:
            nonlocal too_large
            self._is_answered = True
            if message["type"] == "http.response.start" and message["status"] == 413:
                too_large = True
                reason = f"the body is larger than the {_most(scope['path']) / 1e6:g} MB this path takes"
                await JSONResponse({"detail": reason}, 413)(scope, self._receive, send)
            elif not too_large:
                await send(message)

        return noted

    async def receive(self) -> Message:
        """Return the next part."""
        if self._has_ended:  # then the end of the connection, without a deadline
            return await self._receive()
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        left_s = GRACE_S + self._n_bytes / SLOWEST_BYTES_PER_S - self._waited_s
        try:
            async with asyncio.timeout(left_s) as self._waiting:
                message = await self._receive()
        except TimeoutError as error:
            if self._is_answered:
                return {"type": "http.disconnect"}
            reason = f"the body came too slowly: {self._n_bytes} bytes so far"
            raise HTTPException(408, reason, CLOSE) from error
        finally:
            self._waiting = None
            self._waited_s += loop.time() - began_s
        self._n_bytes += len(message.get("body", b""))
        self._has_ended = not message.get("more_body", False)
        return message

    @property
    def is_coming(self) -> bool:
        return self._waiting is not None

    @property
    def bytes_per_s(self) -> float:
        """Mean rate over the time spent waiting for the client."""
        return self._n_bytes / (self._waited_s + 1.0)

    def give_way(self) -> None:
        """Stop waiting for the client."""
        if self._waiting is not None:
            self._waiting.reschedule(asyncio.get_running_loop().time())


def _most(path: str) -> int:
    """Return the limit of a path, B, as its route has it."""
    return UPLOADS.get(path, LOGIN_BYTES if path in {LOGIN_PATH, ENROLL_PATH} else JSON_BYTES)


def name_of(file: UploadFile) -> str:
    """Return the client's name of its file as printable text, never used as a path."""
    name = file.filename or "upload"
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name[:LONGEST_NAME])


@asynccontextmanager
async def on_disk(write: Callable[[IO[bytes]], object]) -> AsyncIterator[Path]:
    """Provide a temporary file that another process can read, for the duration of the block.

    `write` fills the file, in a thread.

    Raises:
        HTTPException: the disk is full.
    """
    with ExitStack() as stack:
        try:
            file = stack.enter_context(NamedTemporaryFile(prefix="calrig-"))
            await run_in_threadpool(write, file.file)
            file.flush()
        except OSError as error:
            raise HTTPException(503, no_room(error.strerror)) from error
        yield Path(file.name)


def copied(upload: UploadFile) -> Callable[[IO[bytes]], None]:
    """Return a function that fills a file with an upload."""
    return partial(copyfileobj, upload.file)
