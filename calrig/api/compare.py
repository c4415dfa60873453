"""Units side by side."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic_core import to_json

from calrig.analysis.comparison import compared_runs, comparison
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.models import Answer, Extremes, LineAnswer

Units = Annotated[
    list[str] | None, Query(description="Serial numbers, in the order wanted; all without any.")
]

router = APIRouter(tags=["units"])


class ComparedRun(LineAnswer):
    """The figures of one completed, not voided calibration."""

    run_id: str
    finished_at: datetime
    temperature_c: Extremes
    effects: list[str]


class ComparedUnit(Answer):
    """A unit's calibrations, the oldest first, and how its bias drifts over them."""

    unit: str
    runs: list[ComparedRun]
    drift_deg_per_day: float | None


class SpreadAnswer(Answer):
    """Standard deviation between units, and of one unit's runs about their mean (repeatability)."""

    between_units_std: float | None
    within_unit_std: float | None
    says: str


class Spreads(Answer):
    """How far units differ, against how well one repeats itself."""

    bias_deg: SpreadAnswer
    scale: SpreadAnswer


class Comparison(Answer):
    """Units side by side."""

    units: list[ComparedUnit]
    spread: Spreads


@router.get("/api/compare", response_model=Comparison, responses=problems(404), summary="Units side by side")
def compare(context: Context, unit: Units = None) -> Response:
    """Completed, not voided calibrations only; `spread` sets units apart from repeatability."""
    document = comparison(compared_runs(context.store, unit))
    # Thousands of rows straight from the store: a test holds them to the model, so that no answer has to be.
    return Response(to_json(document, inf_nan_mode="null"), media_type="application/json")
