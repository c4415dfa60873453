"""What every request passes before anything else looks at it, and the headers that every answer carries.

A web page elsewhere can send requests through an operator's browser. It cannot choose what the browser says
about them: the name it was led to (`Host`), where it comes from (`Origin`, `Sec-Fetch-Site`). Programs say
nothing of the kind and are known by the token alone.
"""

from __future__ import annotations

from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from calrig.api.access import knows
from calrig.api.authentication import Door, address_of

OPEN = frozenset({"/", "/api/health", "/api/login"})
OPEN_FOLDERS = ("/web/",)
"""The page itself holds nothing secret: it must come before anybody can log in on it."""
HARMLESS = frozenset({"GET", "HEAD", "OPTIONS"})
OF_THE_PAGE = frozenset({"same-origin", "none"})
"""`Sec-Fetch-Site` of what this service's own page, or a person at the address bar, asks for."""

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


class Guard:
    """ASGI middleware that refuses what must not come in; the rest passes with every answer's headers set."""

    def __init__(self, app: ASGIApp, door: Door) -> None:
        self.app = app
        self.door = door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuses a request with 401, 403 or 429, or passes it on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        asked = HTTPConnection(scope)
        try:
            self._check_name(asked)
            _check_origin(asked)
            if not (scope["path"] in OPEN or scope["path"].startswith(OPEN_FOLDERS)):
                await self.door.check(asked)
        except HTTPException as error:
            refused = JSONResponse({"detail": error.detail}, error.status_code, error.headers)
            await refused(scope, receive, guarded)
            return
        await self.app(scope, receive, guarded)

    def _check_name(self, asked: HTTPConnection) -> None:
        hosts = asked.headers.getlist("host")
        server = asked.scope.get("server")
        if len(hosts) == 1 and knows(self.door.access, hosts[0], server[0] if server else None):
            return
        named = " and ".join(_shown(host) for host in hosts) or "no name"
        raise HTTPException(
            403,
            f"a request to {named} from {address_of(asked)}: this service is not known by that name; where "
            "that is one of its names, write it into `hosts = [...]` at the top of calrig.toml",
        )


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
