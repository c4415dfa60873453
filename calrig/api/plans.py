"""Plans: the estimate of a plan on a rig, and the design of a plan."""

from dataclasses import asdict, replace
from functools import partial
from typing import Any

from fastapi import APIRouter
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from calrig.analysis.errors import Invalid
from calrig.analysis.limits import cannot_pass_on
from calrig.analysis.stage_maps import kept_of
from calrig.api.context import ApiContext, Context
from calrig.api.job import Job
from calrig.api.jobs import Heavy, Wait
from calrig.api.models import Body
from calrig.api.routes import answers
from calrig.calibration.plan_design import Goals
from calrig.model.plan import Plan, Until
from calrig.model.plan_design import Design, Estimate
from calrig.runs.plan_designs import DesignInputs, DesignRequest, answer, question
from calrig.runs.plan_estimates import estimate, goals_of, mounts_say, require_reachable, wall_pace
from calrig.runs.rig import overdue_says

router = APIRouter(tags=["runs"])


class PlanOnRig(Body):
    """A plan, and the rig it is meant for; without `rig`, the first one configured.

    `unit` is for `warnings`: without it, limits are those of all units.
    """

    rig: str | None = None
    unit: str = ""
    plan: Plan = Plan()


@router.post("/api/plans/estimate", **answers(Estimate, "Estimate a plan on a rig", 404, 413, 422))
def estimate_plan(body: PlanOnRig, context: Context) -> Estimate:
    """Nothing moves. 422 says why a run of this plan would be refused.

    With `target_std_deg` the duration is the most it takes. The stage's speed is the plan's, else that of the
    last run which the rig completed.
    """
    rig = context.service.known_rig(body.rig)
    store, maps = context.store, context.service.maps
    said = estimate(body.plan, rig, store)
    require_reachable(body.plan, rig, body.unit, store, kept_of(store, rig.name, maps))
    cannot = cannot_pass_on(rig, body.unit, body.plan, store, maps)
    warnings = [*overdue_says(rig), *mounts_say(body.plan), *cannot]
    wall_s = wall_pace(rig, store) * said.duration_s
    return Estimate(**asdict(said), wall_s=wall_s, warnings=warnings)


class WantedPlan(Body):
    """What a plan is to reach: `target_u_deg`, an expanded uncertainty, and `until`; or `time_s`.

    With `until` the run ends as soon as that is reached. `plan` is what it keeps: range, rate, velocity. With
    `trace` effects are to be found in it; with `sweep` it turns without stopping where that is sooner.
    """

    rig: str | None = None
    unit: str = ""
    target_u_deg: float | None = Field(default=None, gt=0, le=90)
    until: Until | None = None
    time_s: float | None = Field(default=None, gt=0, le=86_400)
    trace: bool = True
    sweep: bool = True
    plan: Plan = Plan()


class DesignAnswer(Design):
    """The plan, what to expect of it, and its distance to the best possible one."""

    plan: Plan


@router.post(
    "/api/plans/design",
    **answers(DesignAnswer, "The plan that gets there soonest", 404, 413, 422, as_job=True),
)
async def design_plan(body: WantedPlan, context: Context, heavy: Heavy, wait: Wait = True) -> Any:
    """Nothing moves. 422 says why no plan reaches what is wanted, and what would.

    It is given up where its client leaves; 429 where much is waiting already.
    """

    async def work(job: Job) -> object:
        asked = await run_in_threadpool(_question, body, context)
        found = await job.run(partial(answer, asked), tells_progress=True)
        return found.document()

    return await heavy.answer(work, wait=wait)


def _question(body: WantedPlan, context: ApiContext) -> DesignInputs:
    rig = context.service.known_rig(body.rig)
    goals = Goals() if body.until is None else goals_of(body.until)
    goals = replace(goals, expanded_deg=body.target_u_deg or goals.expanded_deg)
    if (goals == Goals()) == (body.time_s is None):
        raise Invalid(
            "Give either what is to be reached (target_u_deg, until) or a time (time_s)", ["time_s"]
        )
    wanted = DesignRequest(goals, body.time_s, body.trace, body.until, body.sweep)
    return question(wanted, body.plan, rig, body.unit, context.store, context.service.maps)
