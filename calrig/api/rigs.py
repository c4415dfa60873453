"""Rigs: the mean error map, the stage map in force, and the check standard."""

from datetime import datetime
from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from calrig import figures
from calrig.analysis.check_standard import check_document
from calrig.analysis.error_map import basis_of, poses_by_mounting, solved_map
from calrig.analysis.stage_maps import listed_maps, put_in_force, shown_map
from calrig.api.access import Who
from calrig.api.context import ApiContext, Context
from calrig.api.jobs import BackgroundWork, Heavy
from calrig.api.models import Body
from calrig.api.routes import CHANGES, answers
from calrig.model.base import Model
from calrig.model.noise import Figure
from calrig.model.solution import ErrorMap
from calrig.store.rigs import CheckUnit

router = APIRouter(tags=["rigs"])


@router.get("/api/rigs/{name}/error-map", **answers(ErrorMap, "The rig error map", 404, 429))
async def show_error_map(name: str, context: Context, heavy: Heavy) -> ErrorMap:
    """Stage and units solved together over the rig's newest runs.

    One unit that was clamped at several angles fixes it for all; empty before, and `says` what would help.
    """
    return await _map_of(name, context, heavy)


@router.get("/api/rigs/{name}/figures/error-map", **answers(Figure, "The rig error map, drawn", 404, 429))
async def rig_error_map(name: str, context: Context, heavy: Heavy) -> figures.Figure:
    """By angle of the dial and approach; empty while it is not known."""
    found = await _map_of(name, context, heavy)
    return figures.error_map(found.stage_deg, found.approach, found.error_deg, found.std_deg)


async def _map_of(name: str, context: ApiContext, heavy: BackgroundWork) -> ErrorMap:
    context.service.known_rig(name)
    basis = await run_in_threadpool(basis_of, context.store, name)
    known = context.error_maps.get(name)
    if known is not None and known[0] == basis:
        return known[1]
    lots = await run_in_threadpool(poses_by_mounting, context.store, basis)
    found: ErrorMap = await heavy(partial(solved_map, lots, basis))
    context.error_maps[name] = basis, found
    return found


class PutMap(Body):
    """The solution whose map it is to be; null withdraws the one in force."""

    solve: str | None
    reason: str = Field("withdrawn", max_length=1000, description="Of a withdrawal.")


class MapColumns(Model):
    """The map over the dial, its mean taken off, in the middle of the play."""

    stage_deg: list[float]
    error_deg: list[float]
    std_deg: list[float]


class HoldsAnswer(Model):
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


class StageMapAnswer(Model):
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


class NamedMap(Model):
    """Which map is in force for a rig: of a solution, or of a file."""

    rig: str
    sha256: str
    solve: str | None
    file: str | None


@router.get("/api/stage-maps", **answers(list[NamedMap], "The maps in force, of all rigs that have one"))
def list_maps(context: Context) -> object:
    """By name of the rig."""
    return listed_maps(context.store, context.service.maps)


@router.get("/api/rigs/{name}/map", **answers(StageMapAnswer, "The stage's map in force", 404))
def show_map(name: str, context: Context) -> object:
    """404 where the rig rests on its certificate alone."""
    rig = context.service.known_rig(name)
    return shown_map(context.store, rig, context.service.maps)


@router.post(
    "/api/rigs/{name}/map",
    **answers(
        StageMapAnswer | None, "Put the map of a solution in force, or withdraw it", *CHANGES, role="admin"
    ),
)
def put_map(name: str, body: PutMap, context: Context, who: Who) -> object:
    """Runs from now on rest on it; those that are there never change. 409 where it is not separable.

    Withdrawn, it leaves the file that the configuration names, or null.
    """
    rig = context.service.known_rig(name)
    if body.solve is not None:
        put_in_force(context.store, name, body.solve, who=who)
    else:
        context.store.stage_maps.withdraw(name, body.reason, who=who)
        if name not in context.service.maps:
            return None
    return shown_map(context.store, rig, context.service.maps)


class NameCheckUnit(Body):
    """The unit, and how often it is to be put on the rig."""

    unit: str
    interval_days: Annotated[float, Field(gt=0, le=36_500)] = 30.0


class CheckAnswer(Model):
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


class CheckUnitAnswer(CheckUnit):
    """How a rig stands by its check unit, and the runs that a failure puts in doubt."""

    state: Literal["passed", "failed", "not_known"]
    last_check_at: datetime | None
    last_passed_at: datetime | None
    due_at: datetime
    overdue: bool
    says: str
    checks: list[CheckAnswer]
    suspect_runs: list[str]


@router.get("/api/check-units", **answers(list[CheckUnit], "The check units of all rigs that have one"))
def list_check_units(context: Context) -> object:
    """By name of the rig."""
    return context.store.check_standards.all()


@router.get(
    "/api/rigs/{name}/check-unit", **answers(CheckUnitAnswer, "How a rig stands by its check unit", 404)
)
def show_check_unit(name: str, context: Context) -> object:
    """404 where it has none."""
    context.service.known_rig(name)
    return check_document(context.store, name)


@router.put(
    "/api/rigs/{name}/check-unit",
    **answers(CheckUnitAnswer, "Name the unit that a rig is checked by", 404, 413, 422, role="releaser"),
)
def put_check_unit(name: str, body: NameCheckUnit, context: Context, who: Who) -> object:
    """Its runs on the rig from now on are checks; its earlier runs are the baseline for the first check."""
    context.service.known_rig(name)
    context.store.check_standards.name(name, body.unit, body.interval_days, who=who)
    return check_document(context.store, name)


@router.delete(
    "/api/rigs/{name}/check-unit",
    **answers(None, "Go without a check unit", 404, role="releaser", status=204),
)
def delete_check_unit(name: str, context: Context, who: Who) -> None:
    """Nothing is in doubt any more that a check had put in doubt."""
    context.store.check_standards.remove(name, who=who)
