"""What every request passes before anything else looks at it, and the headers that every answer carries.

A web page elsewhere can send requests through an operator's browser. It cannot choose what the browser says
about them: the name it was led to (`Host`), where it comes from (`Origin`, `Sec-Fetch-Site`). Programs say
nothing of the kind and are known by the token alone.

Who changed what: a line in the log for each request that changes something, or that failed.
"""

import logging
import re
import time

from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from calrig.api.access import CLOSE, Access, address_in, address_of, caller_of, is_loopback
from calrig.api.authentication import Authentication

OPEN = frozenset({"/", "/api/health", "/api/login", "/api/benches/enroll"})
OPEN_FOLDERS = ("/web/",)
"""The page itself holds nothing secret: it must come before anybody can log in on it."""
HARMLESS = frozenset({"GET", "HEAD", "OPTIONS"})
OF_THE_PAGE = frozenset({"same-origin", "none"})
"""`Sec-Fetch-Site` of what this service's own page, or a person at the address bar, asks for."""

_HOST_FORM = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^\s:/@\[\]]+)(:[0-9]{1,5})?")

CONTENT_SECURITY_POLICY = "; ".join(
    [
        "default-src 'self'",
        "style-src 'self' 'unsafe-inline'",  # plotly sets styles on what it draws
        "img-src 'self' data: blob:",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    ]
)
HEADERS = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


NOT_KEPT = {"Cache-Control": "no-store"}
"""Of all that the API answers: it is for who asked, and true now."""


class OriginCheck:
    """ASGI middleware that refuses what must not come in; the rest passes with every answer's headers set."""

    def __init__(self, app: ASGIApp, authentication: Authentication) -> None:
        self.app = app
        self.authentication = authentication

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuses a request with 401, 403 or 429, or passes it on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(HEADERS)
                if scope["path"].startswith("/api/"):
                    headers.update(NOT_KEPT)
            await send(message)

        asked = HTTPConnection(scope)
        try:
            self._check_name(asked)
            _check_origin(asked)
            is_open = scope["path"] in OPEN or scope["path"].startswith(OPEN_FOLDERS)
            await self.authentication.check(asked, is_open=is_open)
        except HTTPException as error:
            headers = {**(error.headers or {}), **CLOSE}
            refused = JSONResponse({"detail": error.detail}, error.status_code, headers)
            await refused(scope, receive, with_headers)
            return
        await self.app(scope, receive, with_headers)

    def _check_name(self, asked: HTTPConnection) -> None:
        hosts = asked.headers.getlist("host")
        server = asked.scope.get("server")
        if len(hosts) == 1 and knows(self.authentication.access, hosts[0], server[0] if server else None):
            return
        named = " and ".join(_shown(host) for host in hosts) or "no name"
        raise HTTPException(
            403,
            f"a request to {named} from {address_of(asked)}: this service is not known by that name; where "
            "that is one of its names, write it into `hosts = [...]` at the top of calrig.toml",
        )


def knows(access: Access, host: str, server: str | None) -> bool:
    """Whether a Host header names the service.

    A page elsewhere can have any name of its own lead here, but the browser sends that very name: DNS
    rebinding ends at this check. Ports are not looked at: no name becomes somebody else's by its port, and
    `ssh -L` changes them.

    `host` is the header, `name`, `name:port` or `[address]:port`; `server` is the address at which the
    connection came in, None where it has none.
    """
    form = _HOST_FORM.fullmatch(host)
    if form is None:
        return False
    name = form[1].strip("[]").lower()
    if name in access.names:
        return True
    if server is None:
        return False
    if is_loopback(server):
        return name == "localhost" or is_loopback(name)
    return name == server.lower() or (address_in(name) == address_in(server) is not None)


def _check_origin(asked: HTTPConnection) -> None:
    """Refuses what a page elsewhere has a browser send, save links that are followed: they only show."""
    harmless = asked.scope["method"] in HARMLESS
    own = f"{asked.scope['scheme']}://{asked.headers['host'].lower()}"
    origins = asked.headers.getlist("origin")
    if not harmless and any(origin.lower() != own for origin in origins):
        raise HTTPException(
            403,
            f"a page of {' and '.join(_shown(origin) for origin in origins)}, in a browser at "
            f"{address_of(asked)}, may change nothing at {own}; a proxy in front has to pass on Host and "
            "X-Forwarded-Proto",
        )
    followed = harmless and asked.headers.get("sec-fetch-mode") == "navigate"
    site = asked.headers.get("sec-fetch-site", "none")
    if site not in OF_THE_PAGE and not followed:
        raise HTTPException(
            403, f"a page elsewhere ({_shown(site)}), in a browser at {address_of(asked)}, gets nothing"
        )


def _shown(text: str) -> str:
    """What somebody sent, for a sentence: printable, and not too much of it."""
    return ascii(text[:100])


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
    run_id = scope.get("path_params", {}).get("run_id")
    fields = {
        **({} if run_id is None else {"run_id": run_id}),
        **({} if caller is None or caller.name is None else {"user": caller.name}),
        "client": client[0] if client else "?",
        "method": scope["method"],
        "path": scope["path"],
        "status": status,
        "duration_s": round(took_s, 4),
    }
    level = logging.ERROR if status >= 500 else logging.WARNING if status in REFUSED else logging.INFO
    log.log(level, "%s %s: %d", scope["method"], scope["path"], status, extra={"fields": fields})
