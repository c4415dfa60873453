"""Units: who they are, their runs, their calibration in force. A serial number may contain `/`."""

from dataclasses import asdict

from fastapi import APIRouter

from calrig.api.calibrations import document_of, run_in_force
from calrig.api.context import Context, KnownUnit
from calrig.api.errors import problems
from calrig.api.models import CalibrationAnswer, UnitAnswer, UnitWithRuns

EVERY_RUN = 2**31

router = APIRouter(tags=["units"])


@router.get("/api/units", response_model=list[UnitAnswer], summary="Every unit, by serial number")
def list_units(context: Context) -> object:
    """How often each was on a rig, and when last."""
    return context.store.units()


# The longer paths come first: `{serial:path}` would take their ends for parts of the serial number.
@router.get(
    "/api/units/{serial:path}/calibration",
    response_model=CalibrationAnswer,
    responses=problems(404),
    summary="The calibration in force",
)
def show_calibration(serial: str, context: Context) -> object:
    """From the latest completed, not voided calibration whose scale is known."""
    return document_of(context.store, run_in_force(context.store, serial))


@router.get(
    "/api/units/{serial:path}", response_model=UnitWithRuns, responses=problems(404), summary="One unit"
)
def show_unit(unit: KnownUnit, context: Context) -> object:
    """With all its runs, newest first."""
    runs, _ = context.store.runs(unit=unit.serial, limit=EVERY_RUN)
    return {**asdict(unit), "runs": runs}
