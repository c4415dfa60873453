"""Units side by side, and what changed from each run of a unit to the next."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, TypeVar

from fastapi import APIRouter, Query
from fastapi.responses import Response

from calrig.analysis.comparison import comparison_json
from calrig.analysis.histories import unit_changes
from calrig.api.context import ApiContext, Context
from calrig.api.jobs import BackgroundWork, Heavy
from calrig.api.routes import answers
from calrig.model.comparison import Change, Comparison
from calrig.store import Store
from calrig.store.store import with_store

router = APIRouter(tags=["units"])
T = TypeVar("T")


@router.get("/api/units/{serial:path}/changes", **answers(list[Change], "What changed from run to run", 404))
def show_changes(serial: str, context: Context) -> object:
    """From each valid calibration to the next, the oldest first.

    `effects` are those of the stored diagnosis of both runs together; where there is none,
    `POST /api/runs/{to}/diagnosis` with `{"runs": [from]}` makes one.
    """
    return unit_changes(context.store, serial)


Units = Annotated[
    list[str] | None, Query(description="Serial numbers, in the order wanted; all without any.")
]


@router.get("/api/compare", **answers(Comparison, "Units side by side", 404, 429, 503))
def compare(context: Context, heavy: Heavy, unit: Units = None) -> Response:
    """Valid calibrations only; `spread` compares the differences between units with the repeatability.

    Units that changed by more than repeatability come first, in the order of significance. The test uses all
    units of the store, whichever are requested, and of very many runs the latest.
    """
    made = of_units(context, heavy, unit, partial(comparison_json, unit, context.interval_days))
    # Thousands of rows straight from the store: a test holds them to the model, so that no answer has to be.
    return Response(made, media_type="application/json")


FEW_UNITS = 50
"""They are compared within 0.1 s; more are in another process, so that a stop need not wait for them."""


def of_units(
    context: ApiContext, heavy: BackgroundWork, serials: Sequence[str] | None, work: Callable[[Store], T]
) -> T:
    """Return what the work gives for the store: here for a few units, in another process for many."""
    n = context.store.units.count() if serials is None else len(serials)
    if n <= FEW_UNITS:
        return work(context.store)
    return heavy.from_thread(partial(with_store, context.store.url, work))
