"""Background work of requests: run in another process, reported as a job, cancelled on request.

The work is given up when the client leaves. A client that does not wait gets the id of the job.
"""

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

from calrig.analysis.errors import Conflict, Unknown
from calrig.api.access import share_of
from calrig.api.context import Context, context_of
from calrig.api.errors import CLIENT_LEFT
from calrig.api.job import Job
from calrig.api.routes import answers
from calrig.model.service import JobState
from calrig.runs.single_flight import SharedTask
from calrig.store import Store
from calrig.store.store import with_store

router = APIRouter(tags=["jobs"])


async def _known_job(job_id: str, context: Context) -> Job:
    job = context.jobs.get(job_id)
    if job is None:
        raise Unknown(
            f"unknown job {job_id!r}: its record has expired, or the service was restarted. Check "
            "whether the run has the result; if not, repeat the request"
        )
    return job


KnownJob = Annotated[Job, Depends(_known_job)]


@router.get("/api/jobs/{job_id}", **answers(JobState, "How far long work is", 404))
async def show_job(job: KnownJob) -> Job:
    """`fraction` is null where the work cannot say, `result` the address of what came of it, once done."""
    return job


@router.delete("/api/jobs/{job_id}", **answers(JobState, "Cancel long work", 404, role="operator"))
async def cancel_job(job: KnownJob) -> Job:
    """Its process is ended, and nothing is kept of it. One that has ended stays as it is.

    So does one whose answer is being written down: that is one transaction, and is waited for.
    """
    await job.cancel()
    return job


@router.get(
    "/api/jobs/{job_id}/result",
    **answers(
        None, "What came of long work that is kept nowhere else", 404, 409, sends={"application/json": {}}
    ),
)
async def show_result(job: KnownJob) -> Response:
    """As the call that began it would have answered."""
    if not job.content:
        where = f": it is at {job.result}" if job.result else ""
        raise Conflict(f"job {job.id} is {job.state} and keeps no result{where}")
    return Response(job.content, media_type="application/json")


T = TypeVar("T")

AT_ONCE_S = 2.0
"""What is done by then is answered as if it had been waited for."""
Wait = Annotated[
    bool,
    Query(description="Whether to wait for the answer however long it takes; else 202 after two seconds."),
]


class BackgroundWork:
    """Carries out functions for one request, whose body has been read."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self._context = context_of(request.app)
        self._loop = asyncio.get_running_loop()

    async def __call__(self, function: Callable[[], T], *, longest_s: float | None = None) -> T:
        """As `Processes.run`.

        Raises:
            HTTPException: the client has left.
        """
        answer: T = await self.answer(lambda job: job.run(function, longest_s=longest_s))
        return answer

    async def answer(
        self,
        work: Callable[[Job], Awaitable[Any]],
        *,
        wait: bool = True,
        kept_at: Callable[[Any], str] | None = None,
    ) -> Any:
        """What the work gives, or raises what it raises; a 202 with its job where nobody waits for it.

        `work` and `kept_at` are as of a `Job`; by the time that `work` has something run, it has read the
        request. `wait` is for the answer, however long it takes.

        Raises:
            WorkRefused: too much is waiting.
            HTTPException: the client has left.
        """
        user = share_of(self._request)
        self._context.processes.require_room(user)
        job = Job(self._context.processes, user, work, kept_at)
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
            return JSONResponse(JobState.model_validate(job).model_dump(), 202, address)
        finally:
            if not is_taken_on:
                await job.cancel()
            for one in (left, asked):
                one.cancel()
            await asyncio.gather(left, asked, return_exceptions=True)

    async def with_store(self, work: Callable[[Store], T], *, longest_s: float | None = None) -> T:
        """The same for work on the service's store, which the other process opens for reading."""
        return await self(partial(with_store, self._context.store.url, work), longest_s=longest_s)

    def from_thread(self, function: Callable[[], T]) -> T:
        """The same for a thread that does the rest of the request."""
        return asyncio.run_coroutine_threadsafe(self(function), self._loop).result()

    async def _has_left(self) -> None:
        while (await self._request.receive())["type"] != "http.disconnect":
            pass


async def _heavy(request: Request) -> BackgroundWork:
    return BackgroundWork(request)


Heavy = Annotated[BackgroundWork, Depends(_heavy)]


MOST_S = 10.0
"""How long a stop is waited for: longer than any device takes that is not stuck in its system's driver."""


async def answer_of(errand: SharedTask[T], stage: str) -> T:
    """Return the outcome of a stop, which continues even if the client stops waiting.

    Raises:
        Conflict: not in time.
    """
    try:
        async with asyncio.timeout(MOST_S):
            return await asyncio.shield(asyncio.wrap_future(errand.future))
    except TimeoutError as error:
        raise Conflict(
            f"{stage} was told to stop and is not known to stand after {MOST_S:g} s: cut its motor power"
        ) from error
