"""One look into the store for all who want to see the same, however many watch.

Few of many go on in one round of the event loop, so that a crowd of them leaves it to a stop in between.

Where hundreds of requests or streams went on in one round, a stop that came meanwhile would wait for each.

The event streams that are open: woken when their run's log has grown, ended when the service is.
"""

from __future__ import annotations

import asyncio
import re
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from starlette.concurrency import run_in_threadpool
from starlette.types import ASGIApp, Receive, Scope, Send

from calrig.runs.recorder import Bus

GATHER_S = 0.01
"""How long a look waits for others who want the same: those whom the same news has woken."""
T = TypeVar("T")


class ReadCoalescer:
    """Looks that have not begun yet, by what they are for. Used in the server's event loop only.

    Event streams that have come equally far wait for one, which begins after the news that woke them.
    One that has begun is shared with nobody else: it may have missed what they were woken for.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, asyncio.Task[Any]] = {}

    async def share(self, key: Hashable, look: Callable[[], T]) -> T:
        """What a look gives that begins after this call, in a thread.

        Args:
            key: the same for looks that give the same.
            look: reads the store.
        """
        if key not in self._waiting:
            self._waiting[key] = asyncio.create_task(self._gather(key, look))
        found: T = await asyncio.shield(self._waiting[key])
        return found

    async def _gather(self, key: Hashable, look: Callable[[], T]) -> T:
        await asyncio.sleep(GATHER_S)
        del self._waiting[key]
        return await run_in_threadpool(look)


@dataclass(slots=True)
class _Kept:
    """A look that is under way, or what it gave, which is good until then."""

    task: asyncio.Task[Any]
    until_s: float


SHARE = 0.1
"""Of the time that looks for the same may take at most, however long each does."""


class ReadCache:
    """What looks gave, by what they are for: good enough for all who ask again soon. In the event loop only.

    Args:
        now_s: seconds that never go back.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._kept: dict[Hashable, _Kept] = {}

    async def share(self, key: Hashable, look: Callable[[], T], for_s: float) -> T:
        """What a look gave that began at most so long ago; two for the same are never under way at once.

        Args:
            key: the same for looks that give the same.
            look: reads the store, in a thread.
            for_s: how old it may be; of a look that takes long, a multiple of that.
        """
        kept = self._kept.get(key)
        if kept is None or (kept.task.done() and self._now_s() >= kept.until_s):
            kept = self._kept[key] = _Kept(asyncio.create_task(run_in_threadpool(look)), 0.0)
            kept.task.add_done_callback(self._ended(kept, self._now_s(), for_s))
        found: T = await asyncio.shield(kept.task)
        return found

    def _ended(self, kept: _Kept, began_s: float, for_s: float) -> Callable[[asyncio.Task[Any]], None]:
        def note(task: asyncio.Task[Any]) -> None:
            if not task.cancelled() and task.exception() is None:
                kept.until_s = began_s + max(for_s, (self._now_s() - began_s) / SHARE)

        return note


AT_ONCE = re.compile(r"/api/(health|rigs/[^/]+/stop|runs/[^/]+/abort)")
"""Paths of requests that wait for no other."""


class FairScheduler:
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


class FairStartMiddleware:
    """ASGI middleware: requests begin one a round, a stop at once."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._turns = FairScheduler()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on when its turn has come."""
        if scope["type"] == "http" and AT_ONCE.fullmatch(scope["path"]) is None:
            await self._turns.wait()
        await self.app(scope, receive, send)


WRITTEN_IN_A_ROUND = 4
"""Streams written to before the event loop looks what has come: each takes a third of a millisecond."""


@dataclass
class _Watched:
    """A run that somebody watches: the event that each of its streams waits for."""

    news: set[asyncio.Event] = field(default_factory=set)
    leave: Callable[[], None] = lambda: None


class Streams:
    """All event streams of a service, by their run. Used in the server's event loop only.

    `looks` are theirs into the store, `turns` those of writing.
    """

    def __init__(self) -> None:
        self.closed = False
        self.looks = ReadCoalescer()
        self.turns = FairScheduler(WRITTEN_IN_A_ROUND)
        self._watched: dict[str, _Watched] = {}

    @contextmanager
    def joined(self, bus: Bus, run_id: str) -> Iterator[asyncio.Event]:
        """Counts a stream as open; what is given is set when the run's log has grown or the service ends."""
        watched = self._watched.get(run_id)
        if watched is None:
            watched = self._watched[run_id] = _Watched()
            watched.leave = bus.subscribe(run_id, _waking(watched))
        news = asyncio.Event()
        watched.news.add(news)
        try:
            yield news
        finally:
            watched.news.discard(news)
            if not watched.news:
                watched.leave()
                del self._watched[run_id]

    def __len__(self) -> int:
        return sum(len(watched.news) for watched in list(self._watched.values()))

    def close(self) -> None:
        """Has every stream end: a browser that listens must not keep the service from stopping."""
        self.closed = True
        for watched in self._watched.values():
            _tell(watched)


def _waking(watched: _Watched) -> Callable[[], None]:
    """The call that a run's thread makes: one for all of its streams, not one for each."""
    loop = asyncio.get_running_loop()

    def wake() -> None:
        loop.call_soon_threadsafe(_tell, watched)

    return wake


def _tell(watched: _Watched) -> None:
    for news in watched.news:
        news.set()
