"""What a plan is designed from: what is asked of it, and what its rig has shown: CONTRACT section 9."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from calrig.analysis.errors import Invalid
from calrig.analysis.stage_maps import kept_of
from calrig.calibration.plan_design import DesignProblem, Goals, Pace
from calrig.plan import Plan, Until
from calrig.runs.precision import precision_of
from calrig.runs.reachable import reference_worth
from calrig.runs.rig_pace import RigPace, rig_pace
from calrig.runs.settling import Settling, settling_of
from calrig.runs.sweep_figures import MaySweep, may_sweep
from calrig.settings import RigSettings
from calrig.store import Store
from calrig.store.records import Document


@dataclass(frozen=True, slots=True)
class Wanted:
    """What somebody asks of a plan: an expanded uncertainty, standard errors, or what a time is worth.

    `until` is what its run is to end at; with `sweep` it may turn without stopping.
    """

    goals: Goals
    time_s: float | None = None
    trace: bool = True
    until: Until | None = None
    sweep: bool = True


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked and all that is known: `plan` is what it keeps, `task` what the rig can do.

    `no_sweep` is why the rig may not sweep, where a run of it has shown that.
    """

    wanted: Wanted
    plan: Plan
    task: DesignProblem
    settling: Settling
    no_sweep: str | None = None


def question(
    wanted: Wanted,
    plan: Plan,
    rig: RigSettings,
    unit: str,
    store: Store | None,
    maps: Mapping[str, Document],
) -> Question:
    """What `plan_answers.answer` needs to design the plan for a rig and a unit.

    Args:
        wanted: what it is to reach.
        plan: what it keeps: range, rate, velocity, seed; its settling where none has been measured.
        rig: where it is to run.
        unit: of whose last run on this rig the noise is taken; else that of the last one on the rig.
        store: has the earlier runs; None where there is none yet.
        maps: of the stages, that files give, by rig.

    Raises:
        Invalid: the plan that is kept has no range.
    """
    if plan.kind == "static":
        raise Invalid("a static log has no poses to be designed", ["plan.kind"])
    low, high = min(plan.elevations()), max(plan.elevations())
    if high - low < 1.0:
        raise Invalid(f"a plan over {high - low:g}° has no scale: give it a range", ["plan.start_deg"])
    settling, pace = settling_of(rig, plan, store), rig_pace(rig, store)
    precision = precision_of(rig, unit, store)
    in_force = maps.get(rig.name) if store is None else kept_of(store, rig.name, maps)
    turns = may_sweep(rig, plan, store, pace, precision) if wanted.sweep else MaySweep()
    task = DesignProblem(
        range_deg=(low, high),
        precision=precision,
        pace=_pace(plan, pace, settling.least_s),
        type_b=reference_worth(rig, unit, plan.elevations(), store, in_force),
        trace=wanted.trace,
        until=wanted.until is not None,
        seed=plan.seed,
        sweeping=turns.sweeping,
    )
    return Question(wanted, plan, task, settling, turns.because)


def _pace(plan: Plan, known: RigPace, settle_s: float) -> Pace:
    velocity_dps = None if plan.kind == "sweep" else plan.velocity_dps  # of a sweep, that of its turns
    travel_s = partial(known.travel_s, velocity_dps=velocity_dps)
    return Pace(travel_s, settle_s, known.questions_s, known.begin_s, known.stands_deg, known.pass_s)
