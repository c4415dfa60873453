"""The stage's map that a rig's elevations rest on."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from datetime import datetime
from typing import Literal

from fastapi import APIRouter
from pydantic import Field

from calrig.analysis.stage_maps import listed_maps, put_in_force, shown_map
from calrig.api.callers import Who, requires
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.models import Answer, Body

router = APIRouter(tags=["rigs"])


class PutMap(Body):
    """The solution whose map it is to be; null withdraws the one in force."""

    solve: str | None
    reason: str = Field("withdrawn", max_length=1000, description="Of a withdrawal.")


class MapColumns(Answer):
    """The map over the dial, its mean taken off, in the middle of the play."""

    stage_deg: list[float]
    error_deg: list[float]
    std_deg: list[float]


class HoldsAnswer(Answer):
    """Whether the stage still has this map, by the newest run that can tell."""

    state: Literal["holds", "moved", "not_known"]
    says: str
    unit: str | None
    run_id: str | None
    baseline_run_id: str | None
    p_value: float | None
    largest_deg: float | None
    largest_at_deg: float | None
    at_deg: list[float] = Field(description="Angles of the dial where it is off.")


class StageMapAnswer(Answer):
    """The map in force for a rig, what it is worth, and what it rests on."""

    rig: str
    solve: str | None = Field(description="The solution that it is of; null of a file.")
    file: str | None = Field(description="As the configuration names it; null of a solution.")
    sha256: str
    solved_at: datetime | None = Field(description="Null of a file, which does not tell.")
    put_at: datetime | None
    put_by: str | None
    std_deg: float = Field(description="Standard uncertainty over the range, root mean square.")
    dial_deg: tuple[float, float] = Field(description="The range; beyond it the certificate counts.")
    orders: list[float]
    coefficients_deg: list[float] = Field(description="Cosine and sine of each order, then the play.")
    covariance_deg2: list[list[float]]
    map: MapColumns
    units: list[str]
    runs: list[str] = Field(description="Runs, or files, that it was solved from.")
    holds: HoldsAnswer
    says: str


class NamedMap(Answer):
    """Which map is in force for a rig: of a solution, or of a file."""

    rig: str
    sha256: str
    solve: str | None
    file: str | None


@router.get(
    "/api/stage-maps", response_model=list[NamedMap], summary="The maps in force, of all rigs that have one"
)
def list_maps(context: Context) -> object:
    """By name of the rig."""
    return listed_maps(context.store, context.service.maps)


@router.get(
    "/api/rigs/{name}/map",
    response_model=StageMapAnswer,
    responses=problems(404),
    summary="The stage's map in force",
)
def show_map(name: str, context: Context) -> object:
    """404 where the rig rests on its certificate alone."""
    rig = context.service.known_rig(name)
    return shown_map(context.store, rig, context.service.maps)


@router.post(
    "/api/rigs/{name}/map",
    dependencies=[requires("admin")],
    response_model=StageMapAnswer | None,
    responses=problems(404, 409, 413, 422),
    summary="Put the map of a solution in force, or withdraw it",
)
def put_map(name: str, body: PutMap, context: Context, who: Who) -> object:
    """Runs from now on rest on it; those that are there never change. 409 where it is not separable.

    Withdrawn, it leaves the file that the configuration names, or null.
    """
    rig = context.service.known_rig(name)
    if body.solve is not None:
        put_in_force(context.store, name, body.solve, who=who)
    else:
        context.store.withdraw_stage_map(name, body.reason, who=who)
        if name not in context.service.maps:
            return None
    return shown_map(context.store, rig, context.service.maps)
