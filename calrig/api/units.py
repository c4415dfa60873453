"""Units: who they are, their runs, their calibration in force. A serial number may contain `/`."""

from dataclasses import asdict
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from fastapi.responses import PlainTextResponse

from calrig.api.calibrations import document_of, header_of, run_in_force
from calrig.api.context import Context, KnownUnit
from calrig.api.errors import problems
from calrig.api.models import CalibrationAnswer, UnitAnswer, UnitWithRuns

EVERY_RUN = 2**31

CalibrationFormat = Literal["json", "c-header"]

router = APIRouter(tags=["units"])


@router.get("/api/units", response_model=list[UnitAnswer], summary="Every unit, by serial number")
def list_units(context: Context) -> object:
    """How often each was on a rig, and when last."""
    return context.store.units()


# The longer paths come first: `{serial:path}` would take their ends for parts of the serial number.
@router.get(
    "/api/units/{serial:path}/calibration",
    response_model=CalibrationAnswer,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}, **problems(404, 409)},
    summary="The calibration in force",
)
def show_calibration(
    serial: str, context: Context, format_: Annotated[CalibrationFormat, Query(alias="format")] = "json"
) -> object:
    """From the latest completed, not voided calibration whose scale is known; `c-header` for flight code."""
    run = run_in_force(context.store, serial)
    if format_ == "c-header":
        return PlainTextResponse(header_of(context.store, run))
    return document_of(context.store, run)


@router.get(
    "/api/units/{serial:path}", response_model=UnitWithRuns, responses=problems(404), summary="One unit"
)
def show_unit(unit: KnownUnit, context: Context) -> object:
    """With all its runs, newest first."""
    runs, _ = context.store.runs(unit=unit.serial, limit=EVERY_RUN)
    return {**asdict(unit), "runs": runs}
