"""One look into the store for all event streams that have come equally far, however many watch a run."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from starlette.concurrency import run_in_threadpool

GATHER_S = 0.01
"""How long a look waits for others who want the same: those whom the same news has woken."""
T = TypeVar("T")


class Looks:
    """Looks that have not begun yet, by what they are for. Used in the server's event loop only.

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
