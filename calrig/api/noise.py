"""Studies of noise and filters: of a run's samples, or of uploaded logs, which are kept in a list."""

from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, File, Form, Request, UploadFile
from starlette.concurrency import run_in_threadpool

from calrig.analysis.errors import Invalid, Unknown
from calrig.analysis.log_studies import Study
from calrig.analysis.noise_studies import (
    NAMES,
    gyro_scale_of,
    lay_samples,
    require_static,
    study_file,
    study_samples,
)
from calrig.api.access import Caller, caller_of
from calrig.api.body_limits import LOG_BYTES, copied, name_of, on_disk
from calrig.api.context import ApiContext, Context, KnownRun
from calrig.api.job import Job
from calrig.api.jobs import BackgroundWork, Heavy, Wait
from calrig.api.routes import UPLOADS, answers
from calrig.model.base import Model
from calrig.model.noise import FiltersStudy, NoiseStudy
from calrig.store import Run
from calrig.store.fleet import LogStudy

router = APIRouter(tags=["noise"])

LogFile = Annotated[UploadFile, File(description="CONTRACT section 4's static log")]
Rate = Annotated[float | None, Form(gt=0, le=1e6, description="Samples a second; wins over time_s.")]
Range = Annotated[float | None, Form(gt=0, le=1e5, description="Full scale of raw counts.")]


async def _keeper(request: Request) -> Caller | None:
    caller = caller_of(request)
    return caller if caller is not None and caller.may("operator") else None


Keeper = Annotated[Caller | None, Depends(_keeper)]
"""The caller, if their studies are stored; None for callers who may only read."""


@router.get(
    "/api/runs/{run_id}/noise",
    **answers(NoiseStudy, "The noise in the log of a static run", 404, 409, 422, as_job=True),
)
async def run_noise(run: KnownRun, context: Context, heavy: Heavy, wait: Wait = True) -> Any:
    """Allan deviation, spectrum, distribution and dependence on temperature of each channel."""
    require_static(run)
    return await _of_run("noise", run, context, heavy, wait)


@router.get(
    "/api/runs/{run_id}/filters",
    **answers(FiltersStudy, "The filters side by side on a run's samples", 404, 409, 422, as_job=True),
)
async def run_filters(run: KnownRun, context: Context, heavy: Heavy, wait: Wait = True) -> Any:
    """Jitter, lag and largest offset of each, the Kalman filter tuned from the run's own rests among them."""
    return await _of_run("filters", run, context, heavy, wait)


class Log:
    """An uploaded log, and how it was recorded."""

    def __init__(
        self, file: LogFile, rate_hz: Rate = None, accel_range_g: Range = None, gyro_range_dps: Range = None
    ) -> None:
        self.file, self.recorded = file, (rate_hz, accel_range_g, gyro_range_dps)


UploadedLog = Annotated[Log, Depends()]


@router.post(
    "/api/noise",
    max_body_size=LOG_BYTES,
    **answers(NoiseStudy, "The noise in a log from anybody's sensor", *UPLOADS, as_job=True),
)
async def log_noise(
    heavy: Heavy, context: Context, keeper: Keeper, log: UploadedLog, wait: Wait = True
) -> Any:
    """The sensor was at rest. The study of an operator is stored (`GET /api/log-studies`), the log is not."""
    return await _of_file("noise", log, heavy, context, keeper, wait)


@router.post(
    "/api/filters",
    max_body_size=LOG_BYTES,
    **answers(FiltersStudy, "The filters side by side on a log from anybody's sensor", *UPLOADS, as_job=True),
)
async def log_filters(
    heavy: Heavy, context: Context, keeper: Keeper, log: UploadedLog, wait: Wait = True
) -> Any:
    """The sensor was at rest and was rotated about its x axis. The study of an operator is stored."""
    return await _of_file("filters", log, heavy, context, keeper, wait)


async def _of_run(study: Study, run: Run, context: ApiContext, heavy: BackgroundWork, wait: bool) -> Any:
    async def work(job: Job) -> object:
        async with on_disk(partial(lay_samples, context.store, run.id)) as path:
            try:
                return await job.run(partial(study_samples, study, path, NAMES, gyro_scale_of(run)))
            except ValueError as error:
                raise Invalid(f"run {run.id}: {error}") from error

    return await heavy.answer(work, wait=wait)


async def _of_file(
    study: Study, log: Log, heavy: BackgroundWork, context: ApiContext, keeper: Caller | None, wait: bool
) -> Any:
    name, (rate_hz, accel_range_g, gyro_range_dps) = name_of(log.file), log.recorded
    question = partial(
        study_file, study, rate_hz=rate_hz, accel_range_g=accel_range_g, gyro_range_dps=gyro_range_dps
    )

    async def work(job: Job) -> object:
        async with on_disk(copied(log.file)) as path:
            try:
                found = await job.run(partial(question, path), tells_progress=True)
            except ValueError as error:
                raise Invalid(f"{name}: {error}") from error
        if keeper is None:
            return found
        kept = await run_in_threadpool(context.store.studies.save, study, name, found, who=keeper.name)
        return {"id": kept.id, **found}

    return await heavy.answer(work, wait=wait)


class KeptStudy(Model):
    """One with what was found: `noise` or `filters`, the other is null."""

    study: LogStudy
    noise: NoiseStudy | None
    filters: FiltersStudy | None


@router.get("/api/log-studies", **answers(list[LogStudy], "Logs that people brought"))
def studies(context: Context) -> object:
    """The latest 200, the newest first; what each found is at its own address."""
    return context.store.studies.newest()


@router.get("/api/log-studies/{study_id}", **answers(KeptStudy, "What was found in one", 404))
def show_study(study_id: str, context: Context) -> object:
    """As it was answered then."""
    kept = context.store.studies.get(study_id)
    if kept is None:
        raise Unknown(f"there is no study {study_id!r}")
    study, found = kept
    answer = {"id": study.id, **found}
    return {"study": study, "noise": None, "filters": None, study.kind: answer}


@router.delete("/api/log-studies/{study_id}", **answers(None, "Remove one", 404, role="operator", status=204))
def remove_study(study_id: str, context: Context) -> None:
    """For good."""
    if not context.store.studies.remove(study_id):
        raise Unknown(f"there is no study {study_id!r}")
