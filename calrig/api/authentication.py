"""Authentication: a program by its token, a person by a session or by a trusted proxy."""

import asyncio
import hashlib
import hmac
import logging
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NoReturn

from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from calrig.api.access import (
    ANYBODY,
    CLOSE,
    Access,
    Caller,
    People,
    Standing,
    address_of,
    described,
    know,
    network_of,
    place_of,
)
from calrig.store.users import User, token_digest

SESSION_S = 12 * 3600.0
MOST_OF_A_TOKEN = 20
MOST_SESSIONS = 1000


@dataclass(frozen=True, slots=True)
class _Session:
    ends_s: float
    token_sha256: str


class Sessions:
    """A random value for each session, kept in memory and no longer than a day's work.

    A session says by which token it was begun, and opens what that token opens at the time: it ends with the
    token. Of one token's, the oldest gives way to one too many, so that logins of one user end nobody else's;
    the total is bounded as well. All end with the service.

    `clock` tells seconds that only go forward.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # By digest: how long a look-up takes then says nothing about the values that are kept.
        self._kept: dict[bytes, _Session] = {}

    def begin(self, token_sha256: str) -> str:
        """A new session's value."""
        now_s = self._clock()
        self._kept = {value: kept for value, kept in self._kept.items() if kept.ends_s > now_s}
        of_token = [value for value, kept in self._kept.items() if kept.token_sha256 == token_sha256]
        if len(of_token) >= MOST_OF_A_TOKEN:
            del self._kept[of_token[0]]
        elif len(self._kept) >= MOST_SESSIONS:
            del self._kept[next(iter(self._kept))]
        value = secrets.token_urlsafe(32)
        self._kept[_digest(value)] = _Session(now_s + SESSION_S, token_sha256)
        return value

    def token_of(self, value: str) -> str | None:
        """Digest of the token that a session was begun with; None where there is none, or it has ended."""
        kept = self._kept.get(_digest(value))
        return kept.token_sha256 if kept is not None and kept.ends_s > self._clock() else None

    def end(self, value: str) -> None:
        """Ends a session; one that has ended already stays so."""
        self._kept.pop(_digest(value), None)

    def __len__(self) -> int:
        return len(self._kept)


def _digest(value: str) -> bytes:
    return hashlib.sha256(value.encode()).digest()


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


WAITING_EACH = 4
WAITING_ALL = 64
"""Wrong tokens that wait for their answer, from one address and from all."""
SCHEME = "bearer "

log = logging.getLogger(__name__)


class Authentication:
    """Lets in who shows a token or a session that was begun with one, or whom a trusted proxy names.

    What is right is looked at first and never kept waiting, whatever else comes from its address. A wrong
    token is answered late, and while a few wrong ones wait, the next are answered 429 at once. That slows
    nobody who guesses with many connections; the length of the token does (`calrig.api.access`).

    `access` has the service's one token and the trusted proxies; `users` reads who is known by name.
    """

    def __init__(self, access: Access, users: Callable[[], Iterable[User]] = tuple) -> None:
        self.access = access
        self.people = People(users)
        self.sessions = Sessions()
        self._waiting: Counter[str] = Counter()

    @property
    def asks(self) -> bool:
        """Whether clients must authenticate; if not, every client that reaches the service is its admin.

        So it is on loopback until there is a token, a proxy that names people, or an admin among the users,
        who could add the next ones.
        """
        return self.access.token is not None or bool(self.access.proxies) or self.people.have_admin

    async def check(self, asked: HTTPConnection, *, is_open: bool = False) -> None:
        """Lets a request pass; the connection it came by keeps its place from then on, or loses it.

        Every request must authenticate, since a proxy mixes those of many clients; until it has been checked,
        the trust level of the request before applies.

        With `is_open`, who shows nothing, or something wrong, gets what it asks for all the same.

        Raises:
            HTTPException: 401, nothing that is known was shown; 403, a proxy named somebody who is not known;
                429, too many wrong tokens from there just now.
        """
        token = _token_in(asked)
        caller = self._caller(asked, token)
        if caller is not None:
            know(asked, caller)
            place_of(asked).standing = Standing.KNOWN
        elif not self.asks and (token is None or not self.people):
            know(asked, ANYBODY)
            place_of(asked).standing = Standing.ANYBODY
        else:
            place_of(asked).standing = Standing.STRANGER
            if is_open:
                return
            if token is not None and let_in(asked) is None:
                await self._refuse(asked)
            raise self._refusal(asked)

    def _caller(self, asked: HTTPConnection, token: str | None) -> Caller | None:
        """Who it is: a token of their own says it best, then the proxy; the one token names nobody.

        So a proxy may bring the one token along for everybody, and each has their own role all the same.
        """
        by_token = None if token is None else self.of_token(token_digest(token))
        by_token = by_token or self._of_session(asked)
        named = let_in(asked)
        if named is None or (by_token is not None and by_token.name is not None):
            return by_token
        return self.people.of_name(named)

    def of_token(self, sha256: str) -> Caller | None:
        """Whose token has this digest."""
        one = self.access.token
        if one is not None and hmac.compare_digest(sha256, token_digest(one)):
            return ANYBODY
        return self.people.of_token(sha256)

    async def check_token(self, asked: HTTPConnection, token: str) -> None:
        """Lets the right token pass at once; the wrong one waits for its refusal.

        Raises:
            HTTPException: 401, it is wrong; 429, too many wrong ones from there just now.
        """
        caller = self.of_token(token_digest(token))
        if caller is None:
            await self._refuse(asked)
        know(asked, caller)
        place_of(asked).standing = Standing.KNOWN

    async def _refuse(self, asked: HTTPConnection) -> NoReturn:
        """Refuses a wrong token, late."""
        address = address_of(asked)
        network = network_of(address) or address
        if self._waiting[network] >= WAITING_EACH or self._waiting.total() >= WAITING_ALL:
            reason = f"too many wrong tokens from {address}: try again in a moment"
            raise HTTPException(429, reason, {"Retry-After": "1", **CLOSE})
        log.warning("wrong token from %s", address)
        self._waiting[network] += 1
        try:
            await asyncio.sleep(self.access.patience_s)
        finally:
            self._waiting[network] -= 1
            self._waiting += Counter()  # drops who waits no more: the memory is that of those who wait
        raise refusal(f"{described(asked)} has shown a wrong token")

    def _refusal(self, asked: HTTPConnection) -> HTTPException:
        named = let_in(asked)
        if named is not None:
            reason = f"{described(asked)}: {named[:80]!a} was let in by the proxy and is no user here"
            return HTTPException(403, f"{reason}; an admin adds them with `calrig users add NAME`", CLOSE)
        ended = ": the session has ended, log in again" if self.cookie(asked) in asked.cookies else ""
        return refusal(f"{described(asked)} has not shown a token{ended}")

    def has_session(self, asked: HTTPConnection) -> bool:
        """Whether the request carries a session that has not ended."""
        return self._of_session(asked) is not None

    def _of_session(self, asked: HTTPConnection) -> Caller | None:
        value = asked.cookies.get(self.cookie(asked))
        token_sha256 = None if value is None else self.sessions.token_of(value)
        return None if token_sha256 is None else self.of_token(token_sha256)

    def set_cookie(self, asked: HTTPConnection, answer: Response, token: str) -> None:
        """Begins a session, as a cookie that no script reads and no page elsewhere has sent along."""
        answer.set_cookie(
            self.cookie(asked),
            self.sessions.begin(token_digest(token)),
            max_age=int(SESSION_S),
            secure=asked.scope["scheme"] == "https",
            httponly=True,
            samesite="strict",
        )

    def drop_cookie(self, asked: HTTPConnection, answer: Response) -> None:
        """Ends the session whose cookie came along."""
        name = self.cookie(asked)
        self.sessions.end(asked.cookies.get(name, ""))
        answer.delete_cookie(name, httponly=True, samesite="strict")

    @staticmethod
    def cookie(asked: HTTPConnection) -> str:
        """The cookie's name, which has the port in it: cookies of one machine are shared among its ports."""
        server = asked.scope.get("server")
        return f"calrig_session_{server[1] if server else ''}"


def refusal(reason: str) -> HTTPException:
    """The answer to who may not come in, with the ways in."""
    ways = "a program sends `Authorization: Bearer TOKEN`, a person logs in on the page"
    return HTTPException(401, f"{reason}; {ways}", {"WWW-Authenticate": "Bearer", **CLOSE})


def _token_in(asked: HTTPConnection) -> str | None:
    shown = asked.headers.get("authorization", "")
    return shown[len(SCHEME) :].strip() if shown.lower().startswith(SCHEME) else None
