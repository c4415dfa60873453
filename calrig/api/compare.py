"""Units side by side, and what changed from each run of a unit to the next."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic_core import to_json

from calrig.analysis.comparison import compared_runs, comparison, figures_in_force
from calrig.analysis.histories import histories, unit_changes
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.model.comparison import Change, Comparison

router = APIRouter(tags=["units"])


@router.get(
    "/api/units/{serial:path}/changes",
    response_model=list[Change],
    responses=problems(404),
    summary="What changed from run to run",
)
def show_changes(serial: str, context: Context) -> object:
    """From each valid calibration to the next, the oldest first.

    `effects` are those of the stored diagnosis of both runs together; where there is none,
    `POST /api/runs/{to}/diagnosis` with `{"runs": [from]}` makes one.
    """
    return unit_changes(context.store, serial)


Units = Annotated[
    list[str] | None, Query(description="Serial numbers, in the order wanted; all without any.")
]


@router.get("/api/compare", response_model=Comparison, responses=problems(404), summary="Units side by side")
def compare(context: Context, unit: Units = None) -> Response:
    """Valid calibrations only; `spread` compares the differences between units with the repeatability.

    Units that changed by more than repeatability come first, in the order of significance. The test uses all
    units of the store, whichever are requested, and of very many runs the latest.
    """
    found = histories(context.store, unit)
    due = context.due_dates(found, unit)
    in_force = figures_in_force(context.store, unit)
    document = comparison(found, compared_runs(context.store, unit, found), due, in_force)
    # Thousands of rows straight from the store: a test holds them to the model, so that no answer has to be.
    return Response(to_json(document, inf_nan_mode="null"), media_type="application/json")
