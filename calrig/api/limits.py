"""How large a request's body may be. The answer to a larger one is 413, before it is parsed or kept."""

from __future__ import annotations

from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

JSON_BYTES = 1_000_000
UPLOAD_BYTES = 50_000_000
UPLOAD_PATHS = frozenset({"/api/imports", "/api/noise", "/api/filters"})


class BodyLimit:
    """ASGI middleware that refuses bodies beyond the limit of their path.

    A body that says its length is refused at once; one that does not is refused where it passes the limit.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on with a `receive` that counts."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit = UPLOAD_BYTES if scope["path"] in UPLOAD_PATHS else JSON_BYTES
        reason = f"the body is larger than the {limit // 1_000_000} MB this path takes"
        if _content_length(scope) > limit:
            # The rest is read and dropped: a client that is still sending would otherwise see its
            # connection reset instead of the answer.
            while (await receive()).get("more_body", False):
                pass
            await JSONResponse({"detail": reason}, status_code=413)(scope, receive, send)
            return
        received = 0

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > limit:
                raise HTTPException(413, reason)
            return message

        await self.app(scope, counted, send)


def _content_length(scope: Scope) -> int:
    for name, value in scope["headers"]:
        if name == b"content-length" and value.isdigit():
            return int(value)
    return 0
