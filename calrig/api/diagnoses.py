"""Diagnoses: trace the residual, accept effects, start the follow-up run; and the catalogue of effects."""

from contextlib import suppress
from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from calrig.analysis.errors import Invalid, RunsError
from calrig.analysis.stored_runs import request_of
from calrig.api.access import Who
from calrig.api.context import Context, KnownRun
from calrig.api.job import Job
from calrig.api.jobs import Heavy, Wait
from calrig.api.models import Body, RunAnswer
from calrig.api.routes import CHANGES, answers
from calrig.calibration.effects import EFFECTS
from calrig.calibration.poses import DiagnosisError
from calrig.calibration.regression import (
    LONGEST_PERIOD_DEG,
    MOST_PERIODS,
    ORIGINS,
    AssumedReference,
    DiagnosisRequest,
    Effect,
    Origin,
    Scope,
)
from calrig.model.base import Model
from calrig.model.diagnosis import Diagnosis
from calrig.store import Run

router = APIRouter(tags=["diagnoses"])


class Diagnose(Body):
    """What to diagnose together with a run, and what to assume.

    `reference`: `good` if it does not err, so that periodic and smooth terms of the angle are the sensor's;
    absent or null as the rig says. `periods`: known ones of the axis, degrees, beside those of the rig.
    """

    runs: list[str] = Field(default=[], max_length=100)
    reference: AssumedReference | None = None
    periods: list[Annotated[float, Field(gt=0, le=LONGEST_PERIOD_DEG, strict=True)]] = Field(
        default=[], max_length=MOST_PERIODS
    )


class Accept(Body):
    """Names of effects of a diagnosis."""

    effects: Annotated[list[str], Field(min_length=1, max_length=100)]


class TakeBack(Accept):
    """Names of effects that were accepted from a run, and why they are taken back."""

    reason: str


@router.post(
    "/api/runs/{run_id}/diagnosis",
    **answers(Diagnosis, "Trace what bias and scale leave of a run", *CHANGES, role="operator", as_job=True),
)
async def diagnose(run: KnownRun, body: Diagnose, context: Context, heavy: Heavy, wait: Wait = True) -> Any:
    """With more runs of the unit where `runs` names them. The document is kept with the run.

    At most 4,000 poses. It is given up where its client leaves; 429 where many are waiting already. The
    `fraction` of its job is the share of searches done: over all poses, and in each fold of the
    cross-validation.
    """

    async def work(job: Job) -> object:
        try:
            request = await run_in_threadpool(_request, context, run, body)
            question = await run_in_threadpool(context.diagnoses.question, run.id, body.runs, request)
            found = await job.run(question, tells_progress=True)
        except DiagnosisError as error:
            raise Invalid(f"run {run.id}: {error}") from error
        return await run_in_threadpool(context.diagnoses.keep, run.id, found)

    return await heavy.answer(work, wait=wait, kept_at=lambda _: f"/api/runs/{run.id}/diagnosis")


@router.get("/api/runs/{run_id}/diagnosis", **answers(Diagnosis, "The last diagnosis of a run", 404))
def last_diagnosis(run: KnownRun, context: Context) -> object:
    """404 before the first."""
    return context.diagnoses.last(run.id)


@router.post(
    "/api/runs/{run_id}/diagnosis/accept",
    **answers(RunAnswer, "Put effects of a diagnosis in force", *CHANGES, role="releaser"),
)
def accept(run: KnownRun, body: Accept, context: Context, who: Who) -> Run:
    """From now on: those of the sensor for the unit, those of the stage for the rig."""
    return context.acceptance.accept(run.id, body.effects, who=who)


@router.post(
    "/api/runs/{run_id}/diagnosis/withdraw",
    **answers(RunAnswer, "Take accepted effects back", *CHANGES, role="releaser"),
)
def take_back(run: KnownRun, body: TakeBack, context: Context, who: Who) -> Run:
    """What was accepted from this run is in force no more; what was accepted before it is so again."""
    return context.acceptance.take_back(run.id, body.effects, body.reason, who=who)


@router.post(
    "/api/runs/{run_id}/follow-up",
    **answers(
        RunAnswer,
        "Start the run that separates what the diagnosis could not",
        404,
        409,
        role="operator",
        as_job=True,
        status=201,
    ),
)
async def follow_up(run: KnownRun, context: Context, heavy: Heavy, who: Who, wait: Wait = True) -> Any:
    """409, with the reason, where no run on this rig would help. Its diagnosis is of all runs together.

    Until it is designed nothing moves, and its client may leave or its job be cancelled.
    """

    async def work(job: Job) -> Run:
        asked = await run_in_threadpool(context.service.follow_up_question, run.id)
        found = await job.run(asked.work, tells_progress=True)
        return await run_in_threadpool(context.service.follow_up, asked, found, who)

    return await heavy.answer(work, wait=wait, kept_at=lambda begun: f"/api/runs/{begun.id}")


def _request(context: Context, run: KnownRun, body: Diagnose) -> DiagnosisRequest:
    rig = None
    with suppress(RunsError):  # a rig that is not configured here any more, or at several benches
        rig = run.rig and context.service.known_rig(run.rig)
    return request_of(run, rig or None, body.reference, body.periods)


class EffectParameter(Model):
    """A parameter; `unit` is null where it is the covariate's own, `flag` where it is 1 or absent."""

    name: str
    title: str
    unit: str | None
    flag: bool


class CatalogueEffect(Model):
    """An effect of the catalogue: CONTRACT section 5, in words."""

    name: str
    title: str
    sensor_title: str | None  # its title with a good reference, where that is another one
    origin: Origin
    origin_title: str
    scope: Scope
    covariate: str
    covariate_title: str
    covariate_unit: str
    parameters: list[EffectParameter]
    formula: str
    apart: str
    remedy: str


@router.get("/api/effects", **answers(list[CatalogueEffect], "The catalogue of effects"))
def list_effects() -> list[CatalogueEffect]:
    """Every effect that a diagnosis may name, by name, and `unnamed`, the shapes that have none.

    `formula` is what is added to the reading; an effect of scope `unit` is applied in flight, one of scope
    `rig` belongs to the rig error map, one of scope `run` corrects nothing later.
    """
    return [_answer(effect) for effect in EFFECTS.values()]


def _answer(effect: Effect) -> CatalogueEffect:
    return CatalogueEffect(
        name=effect.name,
        title=effect.title,
        sensor_title=None if effect.as_sensor is None else effect.as_sensor.title,
        origin=effect.origin,
        origin_title=ORIGINS[effect.origin],
        scope=effect.scope,
        covariate=effect.covariate.name,
        covariate_title=effect.covariate.title,
        covariate_unit=effect.covariate.unit,
        parameters=[EffectParameter.model_validate(parameter) for parameter in effect.parameters],
        formula=effect.formula,
        apart=effect.told_apart(has_accelerometer=True),
        remedy=effect.remedy,
    )
