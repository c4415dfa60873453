"""Heavy work of a request: carried out in another process, and given up when the client leaves."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, TypeVar

from fastapi import Depends, Request
from starlette.exceptions import HTTPException

from calrig.api.context import context_of

T = TypeVar("T")

CLIENT_LEFT = 499
"""Nobody hears it but the log."""


class HeavyWork:
    """Carries out functions for one request, whose body has been read."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self._processes = context_of(request.app).processes
        self._loop = asyncio.get_running_loop()

    async def __call__(self, function: Callable[[], T]) -> T:
        """As `Processes.run`.

        Raises:
            HTTPException: the client has left.
        """
        work = asyncio.ensure_future(self._processes.run(function))
        left = asyncio.ensure_future(self._has_left())
        try:
            await asyncio.wait({work, left}, return_when=asyncio.FIRST_COMPLETED)
            if work.done():
                return work.result()
            left.result()
            raise HTTPException(CLIENT_LEFT, "the client left before its answer")
        finally:
            work.cancel()
            left.cancel()
            await asyncio.gather(work, left, return_exceptions=True)

    def from_thread(self, function: Callable[[], T]) -> T:
        """The same for a thread that does the rest of the request."""
        return asyncio.run_coroutine_threadsafe(self(function), self._loop).result()

    async def _has_left(self) -> None:
        while (await self._request.receive())["type"] != "http.disconnect":
            pass


async def _heavy(request: Request) -> HeavyWork:
    return HeavyWork(request)


Heavy = Annotated[HeavyWork, Depends(_heavy)]
