"""Who may come in: a program by its token, a person by the session that was begun with it."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import logging
import secrets
import time
from collections import Counter
from collections.abc import Callable
from typing import NoReturn

from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import Response

from calrig.api.access import Access, network_of
from calrig.api.lingering import CLOSE
from calrig.api.standing import Standing, place_of

WAITING_EACH = 4
WAITING_ALL = 64
"""Wrong tokens that wait for their answer, from one address and from all."""
SESSION_S = 12 * 3600.0
MOST_SESSIONS = 100
SCHEME = "bearer "

log = logging.getLogger(__name__)


class Sessions:
    """People who have logged in: a random value each, kept in memory and no longer than a day's work.

    The oldest session gives way to one too many; all end with the service.

    Args:
        clock: seconds that only go forward.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # By digest: how long a look-up takes then says nothing about the values that are kept.
        self._ends_s: dict[bytes, float] = {}

    def begin(self) -> str:
        """A new session's value."""
        now_s = self._clock()
        self._ends_s = {kept: end_s for kept, end_s in self._ends_s.items() if end_s > now_s}
        while len(self._ends_s) >= MOST_SESSIONS:
            del self._ends_s[next(iter(self._ends_s))]
        value = secrets.token_urlsafe(32)
        self._ends_s[_digest(value)] = now_s + SESSION_S
        return value

    def holds(self, value: str) -> bool:
        """Whether the value is that of a session which has not ended."""
        return self._ends_s.get(_digest(value), 0.0) > self._clock()

    def end(self, value: str) -> None:
        """Ends a session; one that has ended already stays so."""
        self._ends_s.pop(_digest(value), None)

    def __len__(self) -> int:
        return len(self._ends_s)


class Authentication:
    """Lets in who shows the token or a session that was begun with it.

    What is right is looked at first and never kept waiting, whatever else comes from its address. A wrong
    token is answered late, and while a few wrong ones wait, the next are answered 429 at once. That slows
    nobody who guesses with many connections; the length of the token does (`calrig.api.access`).

    Args:
        access: the token; without one everybody comes in.
    """

    def __init__(self, access: Access) -> None:
        self.access = access
        self.sessions = Sessions()
        self._waiting: Counter[str] = Counter()

    async def check(self, asked: HTTPConnection, *, is_open: bool = False) -> None:
        """Lets a request pass; the connection it came by keeps its place from then on.

        Args:
            asked: the request.
            is_open: whether who shows nothing, or something wrong, gets what it asks for all the same.

        Raises:
            HTTPException: 401, neither token nor session; 429, too many wrong tokens from there just now.
        """
        if self.access.token is None:
            place_of(asked).standing = Standing.ANYBODY
            return
        shown = asked.headers.get("authorization", "")
        token = shown[len(SCHEME) :].strip() if shown.lower().startswith(SCHEME) else None
        if self.has_session(asked) or (token is not None and self._is_right(token)):
            place_of(asked).standing = Standing.KNOWN
        elif not is_open:
            if token is not None:
                await self._refuse(asked)
            ended = ": the session has ended, log in again" if self.cookie(asked) in asked.cookies else ""
            raise refusal(f"{_who(asked)} has not shown a token{ended}")

    async def check_token(self, asked: HTTPConnection, token: str) -> None:
        """Lets the right token pass at once; the wrong one waits for its refusal.

        Raises:
            HTTPException: 401, it is wrong; 429, too many wrong ones from there just now.
        """
        if not self._is_right(token):
            await self._refuse(asked)
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
        raise refusal(f"{_who(asked)} has shown a wrong token")

    def has_session(self, asked: HTTPConnection) -> bool:
        """Whether the request carries a session that has not ended."""
        value = asked.cookies.get(self.cookie(asked))
        return value is not None and self.sessions.holds(value)

    def set_cookie(self, asked: HTTPConnection, answer: Response) -> None:
        """Begins a session, as a cookie that no script reads and no page elsewhere has sent along."""
        answer.set_cookie(
            self.cookie(asked),
            self.sessions.begin(),
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

    def _is_right(self, token: str) -> bool:
        expected = self.access.token
        return expected is not None and hmac.compare_digest(_digest(token), _digest(expected))


def refusal(reason: str) -> HTTPException:
    """The answer to who may not come in, with the ways in."""
    ways = "a program sends `Authorization: Bearer TOKEN`, a person logs in on the page"
    return HTTPException(401, f"{reason}; {ways}", {"WWW-Authenticate": "Bearer", **CLOSE})


def address_of(asked: HTTPConnection) -> str:
    """Where a request came from."""
    return asked.client.host if asked.client else "an unknown address"


def _who(asked: HTTPConnection) -> str:
    return f"{asked.scope['method']} {asked.scope['path'][:200]!a} from {address_of(asked)}"


def _digest(value: str) -> bytes:
    return hashlib.sha256(value.encode()).digest()
