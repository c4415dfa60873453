"""Heavy work of a request: carried out in another process, and given up when the client leaves.

Who does not want to wait is told by which name it goes on (`calrig.api.jobs`).
"""

# No `from __future__ import annotations`: FastAPI reads the annotations of the dependency.

import asyncio
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Query, Request
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from calrig.api.context import context_of
from calrig.api.errors import CLIENT_LEFT
from calrig.api.job import Job
from calrig.api.models import JobAnswer

T = TypeVar("T")

AT_ONCE_S = 2.0
"""What is done by then is answered as if it had been waited for."""
ACCEPTED: dict[int | str, dict[str, Any]] = {
    202: {"model": JobAnswer, "description": "With `wait=false`, after two seconds: `GET /api/jobs/{id}`"}
}
Wait = Annotated[
    bool,
    Query(description="Whether to wait for the answer however long it takes; else 202 after two seconds."),
]


class HeavyWork:
    """Carries out functions for one request, whose body has been read."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self._context = context_of(request.app)
        self._loop = asyncio.get_running_loop()

    async def __call__(self, function: Callable[[], T]) -> T:
        """As `Processes.run`.

        Raises:
            HTTPException: the client has left.
        """
        answer: T = await self.answer(lambda job: job.run(function))
        return answer

    async def answer(
        self,
        work: Callable[[Job], Awaitable[Any]],
        *,
        wait: bool = True,
        kept_at: Callable[[Any], str] | None = None,
    ) -> Any:
        """What the work gives, or raises what it raises; a 202 with its job where nobody waits for it.

        Args:
            work: as of a `Job`; it has read the request by the time that it has something run.
            wait: however long it takes.
            kept_at: as of a `Job`.

        Raises:
            WorkRefused: too much is waiting.
            HTTPException: the client has left.
        """
        self._context.processes.require_room()
        job = Job(self._context.processes, work, kept_at)
        left = asyncio.ensure_future(self._has_left())
        asked = asyncio.ensure_future(job.asked.wait())
        is_taken_on = False
        try:
            if not wait:
                await asyncio.wait({job.task, left, asked}, return_when=asyncio.FIRST_COMPLETED)
            asked_s = self._loop.time()
            at_most_s = None if wait else AT_ONCE_S
            await asyncio.wait({job.task, left}, timeout=at_most_s, return_when=asyncio.FIRST_COMPLETED)
            in_time = wait or not asked.done() or self._loop.time() - asked_s < AT_ONCE_S
            if job.task.done() and in_time:
                return job.outcome()
            if left.done():
                left.result()
                raise HTTPException(CLIENT_LEFT, "the client left before its answer")
            self._context.jobs.add(job, f"{self._request.method} {self._request.url.path}")
            is_taken_on = True
            address = {"Location": f"/api/jobs/{job.id}"}
            return JSONResponse(JobAnswer.model_validate(job).model_dump(), 202, address)
        finally:
            if not is_taken_on:
                await job.cancel()
            for one in (left, asked):
                one.cancel()
            await asyncio.gather(left, asked, return_exceptions=True)

    def from_thread(self, function: Callable[[], T]) -> T:
        """The same for a thread that does the rest of the request."""
        return asyncio.run_coroutine_threadsafe(self(function), self._loop).result()

    async def _has_left(self) -> None:
        while (await self._request.receive())["type"] != "http.disconnect":
            pass


async def _heavy(request: Request) -> HeavyWork:
    return HeavyWork(request)


Heavy = Annotated[HeavyWork, Depends(_heavy)]
