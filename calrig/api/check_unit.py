"""The unit that a rig is checked by."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter
from pydantic import Field

from calrig.analysis.check_unit import check_document
from calrig.api.callers import Who, requires
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.models import Answer, Body

router = APIRouter(tags=["rigs"])


class NameCheckUnit(Body):
    """The unit, and how often it is to be put on the rig."""

    unit: str
    interval_days: Annotated[float, Field(gt=0, le=36_500)] = 30.0


class CheckAnswer(Answer):
    """A run of the check unit; before it was named one, its history (`is_check` false).

    `average` is the moving average of bias or scale, whichever is farther off, in standard deviations.
    """

    run_id: str
    finished_at: datetime
    bias_deg: float
    scale: float | None
    is_check: bool
    average: float | None
    verdict: Literal["passed", "failed", "not_known"]


class CheckUnitAnswer(Answer):
    """How a rig stands by its check unit, and the runs that a failure puts in doubt."""

    rig: str
    unit: str
    interval_days: float
    named_at: datetime
    state: Literal["passed", "failed", "not_known"]
    last_check_at: datetime | None
    last_passed_at: datetime | None
    due_at: datetime
    overdue: bool
    says: str
    checks: list[CheckAnswer]
    suspect_runs: list[str]


class NamedCheckUnit(Answer):
    """Which unit a rig is checked by, and how often."""

    rig: str
    unit: str
    interval_days: float
    named_at: datetime


@router.get(
    "/api/check-units",
    response_model=list[NamedCheckUnit],
    summary="The check units of all rigs that have one",
)
def list_check_units(context: Context) -> object:
    """By name of the rig."""
    return context.store.check_units()


@router.get(
    "/api/rigs/{name}/check-unit",
    response_model=CheckUnitAnswer,
    responses=problems(404),
    summary="How a rig stands by its check unit",
)
def show_check_unit(name: str, context: Context) -> object:
    """404 where it has none."""
    context.service.known_rig(name)
    return check_document(context.store, name)


@router.put(
    "/api/rigs/{name}/check-unit",
    dependencies=[requires("releaser")],
    response_model=CheckUnitAnswer,
    responses=problems(404, 413, 422),
    summary="Name the unit that a rig is checked by",
)
def put_check_unit(name: str, body: NameCheckUnit, context: Context, who: Who) -> object:
    """Its runs on the rig from now on are checks; those before are what the first is held against."""
    context.service.known_rig(name)
    context.store.name_check_unit(name, body.unit, body.interval_days, who=who)
    return check_document(context.store, name)


@router.delete(
    "/api/rigs/{name}/check-unit",
    dependencies=[requires("releaser")],
    status_code=204,
    responses=problems(404),
    summary="Go without a check unit",
)
def delete_check_unit(name: str, context: Context, who: Who) -> None:
    """Nothing is in doubt any more that a check had put in doubt."""
    context.store.remove_check_unit(name, who=who)
