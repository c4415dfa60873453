"""Who changed what: a line in the log for each request that changes something, or that failed."""

from __future__ import annotations

import logging
import re
import time

from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from calrig.api.callers import caller_of
from calrig.api.origin_check import HARMLESS

log = logging.getLogger(__name__)

LOOKING = re.compile(r"/api/batches/[^/]+/look")
"""What a page asks for every few seconds, and changes nothing that is kept."""
REFUSED = frozenset({401, 403})


class RequestLog:
    """ASGI middleware. Queries, headers and bodies are not logged: tokens and passwords are in there."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, and says afterwards what became of it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        began_s = time.monotonic()
        status = 500  # where the application ends without an answer

        async def noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self.app(scope, receive, noted)
        finally:
            reads = scope["method"] in HARMLESS or LOOKING.fullmatch(scope["path"])
            if not reads or status in REFUSED or status >= 500:
                _say(scope, status, time.monotonic() - began_s)


def _say(scope: Scope, status: int, took_s: float) -> None:
    client, caller = scope.get("client"), caller_of(HTTPConnection(scope))
    named = {name: scope.get("path_params", {}).get(name) for name in ("run_id",)}
    fields = {
        **{name: value for name, value in named.items() if value is not None},
        **({} if caller is None or caller.name is None else {"user": caller.name}),
        "client": client[0] if client else "?",
        "method": scope["method"],
        "path": scope["path"],
        "status": status,
        "duration_s": round(took_s, 4),
    }
    level = logging.ERROR if status >= 500 else logging.WARNING if status in REFUSED else logging.INFO
    log.log(level, "%s %s: %d", scope["method"], scope["path"], status, extra={"fields": fields})
