"""What changed from each run of a unit to the next.

Units side by side.
"""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic import Field
from pydantic_core import to_json

from calrig.analysis.comparison import compared_runs, comparison
from calrig.analysis.histories import histories, unit_changes
from calrig.api.context import Context
from calrig.api.diagnoses import EffectAnswer
from calrig.api.errors import problems
from calrig.api.models import Answer
from calrig.model.result import Extremes, FittedLine
from calrig.model.run import Suspect

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.


router = APIRouter(tags=["units"])


class DifferenceAnswer(Answer):
    """A run less the one before it; `…_sigma` are differences over their standard uncertainties.

    These hold both runs' own standard errors, what clamping anew and the day add (pooled over all units) and,
    from rig to rig, what the stages are worth. Null, as `p_value`, where that cannot be told yet.
    """

    from_: str = Field(alias="from")
    to: str
    days: float
    bias_deg: float | None
    bias_std_deg: float | None
    bias_sigma: float | None
    scale: float | None
    scale_std: float | None
    scale_sigma: float | None
    p_value: float | None
    verdict: Literal["changed", "unchanged", "not_known"]
    effects: list[EffectAnswer] | None = Field(
        description="What the diagnosis of both runs together found changed: null where none is stored."
    )
    says: str


class ChangeAnswer(DifferenceAnswer):
    """A difference, and whether the unit's control chart signals at the later run (null without a chart)."""

    signal: bool | None


@router.get(
    "/api/units/{serial:path}/changes",
    response_model=list[ChangeAnswer],
    responses=problems(404),
    summary="What changed from run to run",
)
def show_changes(serial: str, context: Context) -> object:
    """From each calibration that counts to the next, the oldest first.

    `effects` are those of the stored diagnosis of both runs together; where there is none,
    `POST /api/runs/{to}/diagnosis` with `{"runs": [from]}` makes one.
    """
    return unit_changes(context.store, serial)


# No `from __future__ import annotations`: pydantic reads the annotations of the classes.


Units = Annotated[
    list[str] | None, Query(description="Serial numbers, in the order wanted; all without any.")
]


class ComparedRun(FittedLine):
    """The figures of one completed, not voided calibration."""

    run_id: str
    finished_at: datetime
    temperature_c: Extremes
    effects: list[str]
    suspect: Suspect | None


class ComparedUnit(Answer):
    """A unit's calibrations, the oldest first, how its bias drifts over them, and whether it changed.

    `p_value` is of the unit over all its runs, `change` its most significant difference.
    """

    unit: str
    runs: list[ComparedRun]
    drift_deg_per_day: float | None
    p_value: float | None
    changed: bool
    change: DifferenceAnswer | None
    due_at: datetime | None
    overdue: bool
    due_method: Literal["interval", "drift"] | None
    due_says: str


class SpreadAnswer(Answer):
    """Standard deviation between units, and of one unit's runs about their mean (repeatability)."""

    between_units_std: float | None
    within_unit_std: float | None
    says: str


class Spreads(Answer):
    """How far units differ, against how well one repeats itself."""

    bias_deg: SpreadAnswer
    scale: SpreadAnswer


class RepeatabilityAnswer(Answer):
    """Standard deviations that clamping anew, the day and the rig add to a figure, over all units.

    `day_std` is null where it cannot be told from `reclamping_std`, which then holds both; `freedom` are the
    degrees of freedom that they rest on.
    """

    reclamping_std: float
    day_std: float | None
    rig_std: float
    freedom: int


class RepeatabilitiesAnswer(Answer):
    """How bias and scale repeat (null where the runs do not tell), and by which rule units are marked."""

    bias_deg: RepeatabilityAnswer | None
    scale: RepeatabilityAnswer | None
    false_discovery_rate: float
    rule: str
    says: str


class Comparison(Answer):
    """Units side by side, those first that changed."""

    units: list[ComparedUnit]
    spread: Spreads
    repeatability: RepeatabilitiesAnswer


@router.get("/api/compare", response_model=Comparison, responses=problems(404), summary="Units side by side")
def compare(context: Context, unit: Units = None) -> Response:
    """Calibrations that count only; `spread` sets units apart from repeatability.

    Units that changed by more than repeatability come first, the most significant before the others; whether
    they did is held against all units of the store, whichever are asked for: of very many runs, the latest.
    """
    found = histories(context.store, unit)
    due = context.due_dates(found, unit)
    document = comparison(found, compared_runs(context.store, unit, found), due)
    # Thousands of rows straight from the store: a test holds them to the model, so that no answer has to be.
    return Response(to_json(document, inf_nan_mode="null"), media_type="application/json")
