"""What changed from each run of a unit to the next."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from typing import Literal

from fastapi import APIRouter
from pydantic import Field

from calrig.analysis.unit_changes import unit_changes
from calrig.api.context import Context
from calrig.api.diagnoses import EffectAnswer
from calrig.api.errors import problems
from calrig.api.models import Answer

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
