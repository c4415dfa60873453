"""A number of slots, shared fairly by keys: of those that wait, the one served longest ago goes next."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager


class Turns:
    """Slots that keys take in turn (round robin), each key's own requests in their order.

    Used in one event loop.

    Args:
        slots: how many are taken at once.

    Attributes:
        in_hand: how many requests of each key have a slot or wait for one.
    """

    def __init__(self, slots: int) -> None:
        self.in_hand: Counter[str] = Counter()
        self._free = slots
        self._waiting: dict[str, deque[asyncio.Future[None]]] = {}
        """By key; the key that goes next is first."""

    @asynccontextmanager
    async def slot(self, key: str) -> AsyncIterator[None]:
        """Hold a slot for the block, once it is the key's turn."""
        self.in_hand[key] += 1
        try:
            await self._take(key)
            try:
                yield
            finally:
                self._pass_on()
        finally:
            self.in_hand[key] -= 1
            if not self.in_hand[key]:
                del self.in_hand[key]

    async def _take(self, key: str) -> None:
        if self._free:
            self._free -= 1
            return
        turn = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(key, deque()).append(turn)
        try:
            await turn
        except asyncio.CancelledError:
            if not turn.cancelled():  # the slot came just before
                self._pass_on()
            raise

    def _pass_on(self) -> None:
        while self._waiting:
            key = next(iter(self._waiting))
            turns = self._waiting.pop(key)
            turn = turns.popleft()
            if turns:
                self._waiting[key] = turns  # behind the other keys
            if not turn.done():  # who waited may have left
                turn.set_result(None)
                return
        self._free += 1
