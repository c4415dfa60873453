"""Units: who they are, their runs, their calibration in force. A serial number may contain `/`."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from fastapi.responses import PlainTextResponse
from pydantic import Field

from calrig.analysis.active_calibration import active_run, document_of, header_of
from calrig.api.callers import Who, requires
from calrig.api.context import Context, KnownUnit
from calrig.api.errors import problems
from calrig.api.models import Answer, Extremes, UnitAnswer, UnitWithRuns

EVERY_RUN = 2**31

CalibrationFormat = Literal["json", "c-header"]

router = APIRouter(tags=["units"])


class NamedEffect(Answer):
    """An accepted effect of the unit itself."""

    name: str
    parameters: dict[str, float | None]
    formula: str


class CalibrationGyro(Answer):
    """The gyro's part of a calibration."""

    bias_dps: list[float | None] = Field(min_length=3, max_length=3)
    scale: float | None


class UncertaintyAnswer(Answer):
    """Standard uncertainties of a calibrated elevation; the expanded one contains them all."""

    type_a_deg: float | None
    type_b_deg: float | None
    reference_deg: float | None
    reference_bias_deg: float | None
    reference_scale: float | None


class CalibrationAnswer(Answer):
    """A unit's calibration (CONTRACT section 6)."""

    schema_: Literal["calrig.calibration/1"] = Field(alias="schema")
    unit: str
    run_id: str
    calibrated_at: datetime
    rig: str | None
    range_deg: list[float] = Field(min_length=2, max_length=2)
    model: str
    bias_deg: float
    scale: float
    covariance: list[list[float]] | None
    effects: list[NamedEffect]
    gyro: CalibrationGyro | None
    rms_raw_deg: float
    rms_calibrated_deg: float | None
    rms_with_effects_deg: float | None
    expanded_uncertainty_deg: float | None
    coverage_factor: float
    uncertainty: UncertaintyAnswer
    temperature_c: Extremes | None
    provenance: dict[str, Any]


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
    run = active_run(context.store, serial)
    if format_ == "c-header":
        return PlainTextResponse(header_of(context.store, run))
    return document_of(context.store, run)


@router.get(
    "/api/units/{serial:path}", response_model=UnitWithRuns, responses=problems(404), summary="One unit"
)
def show_unit(unit: KnownUnit, context: Context) -> object:
    """With all its runs, newest first."""
    runs, _ = context.store.runs(unit=unit.serial, limit=EVERY_RUN)
    active = context.store.latest_calibration_run(unit.serial)
    return {**asdict(unit), "runs": runs, "active_run_id": active and active.id}


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
