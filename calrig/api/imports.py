"""Poses measured elsewhere: a CSV becomes a run."""

from contextlib import suppress
from typing import Annotated, Any

from fastapi import APIRouter, File, Form, UploadFile
from starlette.concurrency import run_in_threadpool

from calrig.analysis.errors import Invalid, Unknown
from calrig.analysis.imports import ImportOrigin
from calrig.api.access import Who
from calrig.api.body_limits import POSES_BYTES, copied, name_of, on_disk
from calrig.api.context import Context
from calrig.api.job import Job
from calrig.api.jobs import Heavy, Wait
from calrig.api.models import RunAnswer
from calrig.api.routes import UPLOADS, answers
from calrig.calibration.regression import AssumedReference
from calrig.export.csv_errors import CsvError
from calrig.model.result import MOST_REFERENCE_STD_DEG, StatedKind
from calrig.settings import RigSettings
from calrig.store import Run

router = APIRouter(tags=["runs"])


@router.post(
    "/api/imports",
    max_body_size=POSES_BYTES,
    **answers(RunAnswer, "Make a run of a CSV of poses", *UPLOADS, role="operator", as_job=True, status=201),
)
async def import_poses(
    context: Context,
    heavy: Heavy,
    who: Who,
    file: Annotated[UploadFile, File(description="CONTRACT section 4's CSV")],
    unit: Annotated[str, Form()],
    rig: Annotated[str | None, Form()] = None,
    operator: Annotated[str | None, Form(max_length=200)] = None,
    reference_std_deg: Annotated[
        float | None,
        Form(
            gt=0,
            le=MOST_REFERENCE_STD_DEG,
            description="Standard uncertainty of the reference angles, degrees.",
        ),
    ] = None,
    reference_kind: Annotated[
        StatedKind | None, Form(description="How its error is shared among poses; `harmonic` without it.")
    ] = None,
    reference_certificate: Annotated[
        str | None,
        Form(min_length=1, max_length=100, description="Certificate that the uncertainty is from."),
    ] = None,
    reference: Annotated[
        AssumedReference | None,
        Form(
            description="What its diagnoses assume: `good`, the reference does not err; else as the rig says."
        ),
    ] = None,
    wait: Wait = True,
) -> Any:
    """A bad file is 422, names line and column, and stores nothing.

    U needs a reference: `reference_std_deg`, else the file's column of this name, else the one that the
    rig's configuration states.
    """
    rig, name = rig or None, name_of(file)
    configured: list[RigSettings] = []
    if rig is not None:
        with suppress(Unknown):  # a rig of elsewhere is only a name
            configured.append(await run_in_threadpool(context.service.known_rig, rig))
    origin = ImportOrigin.of(
        rig, configured, reference_std_deg, reference_kind, reference_certificate, reference
    )

    async def work(job: Job) -> Run:
        async with on_disk(copied(file)) as path:
            question = await run_in_threadpool(context.records.question, unit, origin, path)
            try:
                imported = await job.run(question, tells_progress=True)
            except CsvError as error:
                raise Invalid(f"{name}: {error}", ["file"]) from error
        by = who or operator
        return await run_in_threadpool(
            context.records.keep_imported, imported, unit=unit, rig=rig, file_name=name, operator=by
        )

    return await heavy.answer(work, wait=wait, kept_at=lambda run: f"/api/runs/{run.id}")
