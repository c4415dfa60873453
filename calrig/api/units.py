"""Units: who they are and their runs. A serial number may contain `/`."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from dataclasses import asdict

from fastapi import APIRouter

from calrig.analysis.check_unit import with_doubts
from calrig.api.callers import Who, requires
from calrig.api.context import Context, KnownUnit
from calrig.api.errors import problems
from calrig.api.models import UnitAnswer, UnitWithRuns

EVERY_RUN = 2**31

router = APIRouter(tags=["units"])


@router.get("/api/units", response_model=list[UnitAnswer], summary="Every unit, by serial number")
def list_units(context: Context) -> object:
    """How often each was on a rig, when last, and when it is due again."""
    due = context.due_dates()
    return [{**asdict(unit), **due.of(unit.serial).to_dict()} for unit in context.store.units()]


@router.get(
    "/api/units/{serial:path}", response_model=UnitWithRuns, responses=problems(404), summary="One unit"
)
def show_unit(unit: KnownUnit, context: Context) -> object:
    """With all its runs, newest first."""
    runs, _ = context.store.runs(unit=unit.serial, limit=EVERY_RUN)
    in_force = context.store.in_force(unit.serial)
    return {
        **asdict(unit),
        **context.due_dates(serials=[unit.serial]).of(unit.serial).to_dict(),
        "runs": with_doubts(context.store, runs),
        "active_run_id": in_force and in_force.run_id,
        "revision_in_force": in_force and in_force.revision,
    }


@router.delete(
    "/api/units/{serial:path}",
    dependencies=[requires("releaser")],
    status_code=204,
    responses=problems(404, 409),
    summary="Remove a unit that nothing is known of",
)
def remove_unit(serial: str, context: Context, who: Who) -> None:
    """As one is left whose runs were moved to their right serial number. 409 where it has runs."""
    context.store.remove_unit(serial, who=who)
