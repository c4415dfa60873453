"""Limits that units are tested against, in the order in which they are tried."""

from typing import Annotated

from fastapi import APIRouter, Body

from calrig.analysis.limits import replace
from calrig.api.access import Who, requires
from calrig.api.context import Context
from calrig.api.routes import problems
from calrig.model.verdict import Limit
from calrig.settings import LimitSettings

MOST_LIMITS = 100

router = APIRouter(tags=["limits"])


@router.get("/api/limits", summary="The limits, in order")
def list_limits(context: Context) -> list[Limit]:
    """The first that matches a unit (and rig) applies."""
    return context.store.limits.all()


@router.put(
    "/api/limits",
    dependencies=[requires("admin")],
    responses=problems(409, 413, 422),
    summary="Replace the limits",
)
def replace_limits(
    body: Annotated[list[LimitSettings], Body(max_length=MOST_LIMITS)], context: Context, who: Who
) -> list[Limit]:
    """All of them at once. 409 where they are kept in calrig.toml."""
    return replace(context.store, body, who=who, kept_in=context.limits_kept_in)
