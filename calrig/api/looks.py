"""One look into the store for all who want to see the same, however many watch."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, TypeVar

from starlette.concurrency import run_in_threadpool

GATHER_S = 0.01
"""How long a look waits for others who want the same: those whom the same news has woken."""
T = TypeVar("T")


class Looks:
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


class Lately:
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
