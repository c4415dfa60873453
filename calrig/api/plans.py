"""What a plan comes to on a rig, so that whoever writes one need not compute it."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from dataclasses import asdict

from fastapi import APIRouter
from pydantic import Field

from calrig.analysis.limits import cannot_pass_on
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.models import Answer, Body
from calrig.plan import Plan
from calrig.runs.planned import estimate
from calrig.runs.references import overdue_says

router = APIRouter(tags=["runs"])


class PlanOnRig(Body):
    """A plan, and the rig it is meant for; without `rig`, the first one configured.

    `unit` is for `warnings`: without it, limits are those of all units.
    """

    rig: str | None = None
    unit: str = ""
    plan: Plan = Plan()


class EstimateAnswer(Answer):
    """`elevations_deg` are those of one sweep; a static log has no poses."""

    n_poses: int
    elevations_deg: list[float]
    duration_s: float = Field(description="About, by the board's clock; without a wait for a temperature.")
    warnings: list[str] = Field(description="What is known to fail before it has begun, in sentences.")


@router.post(
    "/api/plans/estimate",
    response_model=EstimateAnswer,
    responses=problems(404, 413, 422),
    summary="What a plan comes to",
)
def estimate_plan(body: PlanOnRig, context: Context) -> EstimateAnswer:
    """Nothing moves. 422 says why a run of this plan would be refused.

    With `target_std_deg` the duration is the most it takes. The stage's speed is the plan's, else that of the
    last run which the rig completed.
    """
    rig = context.service.known_rig(body.rig)
    said = estimate(body.plan, rig, context.store)
    warnings = [*overdue_says(rig), *cannot_pass_on(rig, body.unit, body.plan, context.store)]
    return EstimateAnswer(**asdict(said), warnings=warnings)
