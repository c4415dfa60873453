"""Long work that nobody waits for: how far it is, what came of it, and its end on request."""

# No `from __future__ import annotations`: FastAPI reads the annotations of the dependency.

from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import Response

from calrig.analysis.errors import Conflict, Unknown
from calrig.api.callers import requires
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.job import Job
from calrig.api.models import JobAnswer

router = APIRouter(tags=["jobs"])


async def _known_job(job_id: str, context: Context) -> Job:
    job = context.jobs.get(job_id)
    if job is None:
        raise Unknown(
            f"there is no job {job_id!r}: it ended long ago, or the service was started anew since: look "
            "whether the run has what was asked for, else ask again"
        )
    return job


KnownJob = Annotated[Job, Depends(_known_job)]


@router.get(
    "/api/jobs/{job_id}", response_model=JobAnswer, responses=problems(404), summary="How far long work is"
)
async def show_job(job: KnownJob) -> Job:
    """`fraction` is null where the work cannot say, `result` the address of what came of it, once done."""
    return job


@router.delete(
    "/api/jobs/{job_id}",
    dependencies=[requires("operator")],
    response_model=JobAnswer,
    responses=problems(404),
    summary="Cancel long work",
)
async def cancel_job(job: KnownJob) -> Job:
    """Its process is ended, and nothing is kept of it. One that has ended stays as it is.

    So does one whose answer is being written down: that is one transaction, and is waited for.
    """
    await job.cancel()
    return job


@router.get(
    "/api/jobs/{job_id}/result",
    response_class=Response,
    responses={200: {"content": {"application/json": {}}}, **problems(404, 409)},
    summary="What came of long work that is kept nowhere else",
)
async def show_result(job: KnownJob) -> Response:
    """As the call that began it would have answered."""
    if not job.content:
        where = f": it is at {job.result}" if job.result else ""
        raise Conflict(f"job {job.id} is {job.state} and keeps no result{where}")
    return Response(job.content, media_type="application/json")
