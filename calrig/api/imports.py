"""Poses measured elsewhere: a CSV becomes a run."""

from typing import Annotated, Any

from fastapi import APIRouter, File, Form, UploadFile
from starlette.concurrency import run_in_threadpool

from calrig.analysis.errors import Invalid
from calrig.api.access import Who, requires
from calrig.api.body_limits import POSES_BYTES, copied, name_of, on_disk
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.job import Job
from calrig.api.jobs import ACCEPTED, Heavy, Wait
from calrig.api.models import RunAnswer
from calrig.export.csv_errors import CsvError
from calrig.store import Run

router = APIRouter(tags=["runs"])


@router.post(
    "/api/imports",
    dependencies=[requires("operator")],
    max_body_size=POSES_BYTES,
    status_code=201,
    response_model=RunAnswer,
    responses=ACCEPTED | problems(408, 413, 422, 503),
    summary="Make a run of a CSV of poses",
)
async def import_poses(
    context: Context,
    heavy: Heavy,
    who: Who,
    file: Annotated[UploadFile, File(description="CONTRACT section 4's CSV")],
    unit: Annotated[str, Form()],
    rig: Annotated[str | None, Form()] = None,
    operator: Annotated[str | None, Form(max_length=200)] = None,
    wait: Wait = True,
) -> Any:
    """A bad file is 422, names line and column, and stores nothing."""
    rig, name = rig or None, name_of(file)

    async def work(job: Job) -> Run:
        async with on_disk(copied(file)) as path:
            question = await run_in_threadpool(context.records.question, unit, rig, path)
            try:
                imported = await job.run(question, tells_progress=True)
            except CsvError as error:
                raise Invalid(f"{name}: {error}", ["file"]) from error
        by = who or operator
        return await run_in_threadpool(
            context.records.keep_imported, imported, unit=unit, rig=rig, file_name=name, operator=by
        )

    return await heavy.answer(work, wait=wait, kept_at=lambda run: f"/api/runs/{run.id}")
