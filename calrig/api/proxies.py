"""What a proxy in front says of its clients: believed of those that are trusted, dropped of anybody else."""

from __future__ import annotations

from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from calrig.api.access import Access
from calrig.api.callers import address_of

KEY = "calrig_let_in"
"""Where a request's state holds the name of whom a proxy let in."""
THIS_MACHINE = "127.0.0.1"


class TrustedProxies:
    """ASGI middleware that sees the connection's own end, before a header says who is behind it.

    Names of users come in `Access.user_header` and are taken off every request, so that nothing further in
    can be misled. Where the client is and whether it used TLS (`X-Forwarded-For`, `-Proto`) is believed of
    this machine's proxy, too, as before anybody could be named.
    """

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._access = access
        trusted = [THIS_MACHINE, *(str(network) for network in access.proxies)]
        self._app = ProxyHeadersMiddleware(app, trusted)  # type: ignore[arg-type]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, without the header."""
        if scope["type"] == "http":
            header = self._access.user_header.encode()
            said = [value for name, value in scope["headers"] if name == header]
            scope["headers"] = [(name, value) for name, value in scope["headers"] if name != header]
            # Two names are none: one of them may be the client's own, which the proxy let through.
            if len(said) == 1 and self._access.trusts(address_of(HTTPConnection(scope))):
                scope.setdefault("state", {})[KEY] = said[0].decode("latin-1").strip()
        await self._app(scope, receive, send)  # type: ignore[arg-type]


def let_in(asked: HTTPConnection) -> str | None:
    """The name of whom a trusted proxy let in; None where it named nobody."""
    return asked.scope.get("state", {}).get(KEY) or None
