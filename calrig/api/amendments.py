"""What is done to runs after they were measured: voiding, noting, moving, leaving poses out, and back."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import Field

from calrig.api.callers import Who, requires
from calrig.api.context import Context, KnownRun
from calrig.api.errors import problems
from calrig.api.models import Body, Reason, ReasonIfAny, RunAnswer
from calrig.store import Run

router = APIRouter(tags=["runs"])

PoseIndex = Annotated[int, Path(ge=0, lt=2**31)]


class Note(Body):
    """What is to be noted."""

    note: Annotated[str, Field(max_length=10_000)]


class RightUnit(Body):
    """The unit that a run is of, and how that came out."""

    unit: str
    reason: str


@router.post(
    "/api/runs/{run_id}/void",
    dependencies=[requires("releaser")],
    response_model=RunAnswer,
    responses=problems(404, 409, 413, 422),
    summary="Keep a run, out of every comparison",
)
def void_run(run: KnownRun, body: Reason, context: Context, who: Who) -> Run:
    """Nothing is deleted."""
    return context.records.void(run.id, body.reason, who=who)


@router.post(
    "/api/runs/{run_id}/unvoid",
    dependencies=[requires("releaser")],
    response_model=RunAnswer,
    responses=problems(404, 409, 413, 422),
    summary="Have a voided run count again",
)
def unvoid_run(run: KnownRun, body: Reason, context: Context, who: Who) -> Run:
    """409 where it is not voided. Both reasons are in the trail."""
    return context.records.unvoid(run.id, body.reason, who=who)


@router.post(
    "/api/runs/{run_id}/note",
    dependencies=[requires("operator")],
    response_model=RunAnswer,
    responses=problems(404, 413, 422),
    summary="Note something of a run",
)
def note_run(run: KnownRun, body: Note, context: Context, who: Who) -> Run:
    """At any time. It goes below what is noted already, with the time and who says it."""
    return context.records.note(run.id, body.note, who=who)


@router.post(
    "/api/runs/{run_id}/unit",
    dependencies=[requires("releaser")],
    response_model=RunAnswer,
    responses=problems(404, 409, 413, 422),
    summary="Correct a run's serial number",
)
def move_run(run: KnownRun, body: RightUnit, context: Context, who: Who) -> Run:
    """The run moves to that unit with what it follows on and what follows on it; both histories say so.

    409 while one goes on, where an effect accepted from one is in force (take it back first), where one is a
    verification, or where a diagnosis is of moving and staying runs together.
    """
    return context.records.move(run.id, body.unit, body.reason, who=who)


@router.post(
    "/api/runs/{run_id}/poses/{index}/exclude",
    dependencies=[requires("operator")],
    response_model=RunAnswer,
    responses=problems(404, 409, 413, 422),
    summary="Keep a pose, out of the result",
)
def exclude_pose(run: KnownRun, index: PoseIndex, body: Reason, context: Context, who: Who) -> Run:
    """The result is computed again from the poses that are left."""
    return context.records.exclude_pose(run.id, index, body.reason, who=who)


@router.post(
    "/api/runs/{run_id}/poses/{index}/include",
    dependencies=[requires("operator")],
    response_model=RunAnswer,
    responses=problems(404, 409, 413, 422),
    summary="Have an excluded pose count again",
)
def include_pose(
    run: KnownRun, index: PoseIndex, context: Context, who: Who, body: ReasonIfAny | None = None
) -> Run:
    """The result is computed again with it."""
    return context.records.include_pose(run.id, index, None if body is None else body.reason, who=who)
