"""Few of many go on in one round of the event loop, so that a crowd of them leaves it to a stop in between.

Where hundreds of requests or streams went on in one round, a stop that came meanwhile would wait for each.
"""

from __future__ import annotations

import asyncio
import re
from collections import deque

from starlette.types import ASGIApp, Receive, Scope, Send

AT_ONCE = re.compile(r"/api/(health|rigs/[^/]+/stop|runs/[^/]+/abort)")
"""Paths of requests that wait for no other."""


class Turns:
    """Turns of those who wait, in their order. Used in one event loop.

    Args:
        in_a_round: how many go on before the loop takes what has come meanwhile.
    """

    def __init__(self, in_a_round: int = 1) -> None:
        self._in_a_round = in_a_round
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._goes_round = False

    async def wait(self) -> None:
        """Until it is one's turn."""
        loop = asyncio.get_running_loop()
        turn = loop.create_future()
        self._waiting.append(turn)
        if not self._goes_round:
            self._goes_round = True
            loop.call_soon(self._round, loop)
        await turn

    def _round(self, loop: asyncio.AbstractEventLoop) -> None:
        for _ in range(min(self._in_a_round, len(self._waiting))):
            turn = self._waiting.popleft()
            if not turn.done():  # cancelled
                turn.set_result(None)
        self._goes_round = bool(self._waiting)
        if self._goes_round:
            loop.call_soon(self._round, loop)  # in the round after this one


class BeginInTurn:
    """ASGI middleware: requests begin one a round, a stop at once."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._turns = Turns()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on when its turn has come."""
        if scope["type"] == "http" and AT_ONCE.fullmatch(scope["path"]) is None:
            await self._turns.wait()
        await self.app(scope, receive, send)
