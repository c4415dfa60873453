"""Event streams and crowds of requests: shared reads of the store, and turns in the event loop.

Few of many requests or streams proceed per iteration of the loop, so that a stop request never waits for all.
"""

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
"""How long a read waits for others of the same key: the streams that the same event has woken."""
T = TypeVar("T")


class ReadCoalescer:
    """Coalesce reads of the same key that have not begun yet. Use in the event loop only.

    Event streams at the same position share one read, which begins after the event that woke them. A read
    that has begun is not shared any more, because it may have missed a later event.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, asyncio.Task[Any]] = {}

    async def share(self, key: Hashable, look: Callable[[], T]) -> T:
        """Return the result of a read that begins after this call, in a thread.

        `key` is equal for reads with equal results.
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
    """A read in progress, or its result, which is valid until `until_s`."""

    task: asyncio.Task[Any]
    until_s: float


SHARE = 0.1
"""Maximum share of the time that reads of one key take."""


class ReadCache:
    """Cache recent store reads by key for a short time, with at most one read per key in progress.

    Use in the event loop only.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._kept: dict[Hashable, _Kept] = {}

    async def share(self, key: Hashable, look: Callable[[], T], for_s: float) -> T:
        """Return the result of a recent read.

        `key` is equal for reads with equal results; `for_s` is the maximum age of the result, longer if the
        read takes more than `SHARE` of it.
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
"""Paths of requests that are never delayed."""


class FairScheduler:
    """Limit how many waiters proceed per event-loop iteration, in their order. Use in one event loop.

    `in_a_round` are waiters per iteration.
    """

    def __init__(self, in_a_round: int = 1) -> None:
        self._in_a_round = in_a_round
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._goes_round = False

    async def wait(self) -> None:
        """Wait for the caller's turn."""
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
            loop.call_soon(self._round, loop)  # in the next iteration


class FairStartMiddleware:
    """ASGI middleware: one request begins per event-loop iteration, a stop request at once."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._turns = FairScheduler()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when its turn has come."""
        if scope["type"] == "http" and AT_ONCE.fullmatch(scope["path"]) is None:
            await self._turns.wait()
        await self.app(scope, receive, send)


WRITTEN_IN_A_ROUND = 4
"""Streams written to per event-loop iteration: each takes a third of a millisecond."""


@dataclass
class _Watched:
    """A watched run: the event of each of its streams."""

    news: set[asyncio.Event] = field(default_factory=set)
    leave: Callable[[], None] = lambda: None


class Streams:
    """All event streams of a service, by run. Use in the event loop only.

    Attributes:
        closed: whether the service ends.
        looks: coalesces their reads of the store.
        turns: schedules their writes.
    """

    def __init__(self) -> None:
        self.closed = False
        self.looks = ReadCoalescer()
        self.turns = FairScheduler(WRITTEN_IN_A_ROUND)
        self._watched: dict[str, _Watched] = {}

    @contextmanager
    def joined(self, bus: Bus, run_id: str) -> Iterator[asyncio.Event]:
        """Register a stream; its event is set when the run's log grows or the service ends."""
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
        """End every stream, so that no open browser delays the service's shutdown."""
        self.closed = True
        for watched in self._watched.values():
            _tell(watched)


def _waking(watched: _Watched) -> Callable[[], None]:
    """Return the callback for the run's thread: one for all of its streams."""
    loop = asyncio.get_running_loop()

    def wake() -> None:
        loop.call_soon_threadsafe(_tell, watched)

    return wake


def _tell(watched: _Watched) -> None:
    for news in watched.news:
        news.set()
