"""Who may come in: a program by its token, a person by a session begun with one or by a trusted proxy."""

from __future__ import annotations

import asyncio
import hmac
import logging
from collections import Counter
from collections.abc import Callable, Iterable
from typing import NoReturn

from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import Response

from calrig.api.access import Access, network_of
from calrig.api.callers import ANYBODY, Caller, People, address_of, described, know
from calrig.api.lingering import CLOSE
from calrig.api.proxies import let_in
from calrig.api.sessions import SESSION_S, Sessions
from calrig.api.standing import Standing, place_of
from calrig.store.users import User, token_digest

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

    Args:
        access: the service's one token, and the proxies that are trusted.
        users: reads who is known by name.
    """

    def __init__(self, access: Access, users: Callable[[], Iterable[User]] = tuple) -> None:
        self.access = access
        self.people = People(users)
        self.sessions = Sessions()
        self._waiting: Counter[str] = Counter()

    @property
    def asks(self) -> bool:
        """Whether anybody has to show who they are; without, whoever reaches the service is its admin.

        So it is on loopback until there is a token, a proxy that names people, or an admin among the users,
        who could add the next ones.
        """
        return self.access.token is not None or bool(self.access.proxies) or self.people.have_admin

    async def check(self, asked: HTTPConnection, *, is_open: bool = False) -> None:
        """Lets a request pass; the connection it came by keeps its place from then on.

        Args:
            asked: the request.
            is_open: whether who shows nothing, or something wrong, gets what it asks for all the same.

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
        elif not is_open:
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
