"""The rig's error map, solved in another process and kept while the runs that it rests on are the same."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from functools import partial

from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool

from calrig import figures
from calrig.analysis.error_map import ErrorMap, basis_of, lots_of, solved_map
from calrig.api.context import ApiContext, Context
from calrig.api.errors import problems
from calrig.api.heavy import Heavy, HeavyWork
from calrig.api.models import Answer, Figure

router = APIRouter(tags=["rigs"])


class ErrorMapAnswer(Answer):
    """What the elevation is more than the dial says, by its angle and approach, from so many units."""

    stage_deg: list[float]
    approach: list[int]
    error_deg: list[float]
    std_deg: list[float]
    units: int
    says: str


@router.get(
    "/api/rigs/{name}/error-map",
    response_model=ErrorMapAnswer,
    responses=problems(404, 429),
    summary="The rig error map",
)
async def show_error_map(name: str, context: Context, heavy: Heavy) -> ErrorMap:
    """Stage and units solved together over the rig's newest runs.

    One unit that was clamped at several angles fixes it for all; empty before, and `says` what would help.
    """
    return await _map_of(name, context, heavy)


@router.get(
    "/api/rigs/{name}/figures/error-map",
    response_model=Figure,
    responses=problems(404, 429),
    summary="The rig error map, drawn",
)
async def rig_error_map(name: str, context: Context, heavy: Heavy) -> figures.Figure:
    """By angle of the dial and approach; empty while it is not known."""
    found = await _map_of(name, context, heavy)
    return figures.error_map(found.stage_deg, found.approach, found.error_deg, found.std_deg)


async def _map_of(name: str, context: ApiContext, heavy: HeavyWork) -> ErrorMap:
    context.service.known_rig(name)
    basis = await run_in_threadpool(basis_of, context.store, name)
    known = context.error_maps.get(name)
    if known is not None and known[0] == basis:
        return known[1]
    lots = await run_in_threadpool(lots_of, context.store, basis)
    found: ErrorMap = await heavy(partial(solved_map, lots, basis))
    context.error_maps[name] = basis, found
    return found
