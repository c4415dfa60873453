"""What a plan is designed from: what is asked of it, and what its rig has shown: CONTRACT section 9."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from calrig.analysis.errors import Invalid
from calrig.analysis.stage_maps import kept_of
from calrig.calibration.plan_design.design import Task
from calrig.calibration.plan_design.goals import Goals, TypeB
from calrig.calibration.plan_design.rig_figures import NOT_MEASURED, Pace, Precision, precision_of_run
from calrig.calibration.stage_reference import StageMap
from calrig.calibration.uncertainty import Reference
from calrig.plan import Plan, Until
from calrig.run_ids import short_name
from calrig.runs.rig_pace import rig_pace
from calrig.runs.settling import Settling, settling_of
from calrig.settings import RigSettings
from calrig.store import Run, Store
from calrig.store.records import Document


@dataclass(frozen=True, slots=True)
class Wanted:
    """What somebody asks of a plan: an expanded uncertainty, standard errors, or what a time is worth.

    `until` is what its run is to end at.
    """

    goals: Goals
    time_s: float | None = None
    trace: bool = True
    until: Until | None = None


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked and all that is known: `plan` is what it keeps, `task` what the rig can do."""

    wanted: Wanted
    plan: Plan
    task: Task
    settling: Settling


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
    low, high = min(plan.elevations()), max(plan.elevations())
    if high - low < 1.0:
        raise Invalid(f"a plan over {high - low:g}° has no scale: give it a range", ["plan.start_deg"])
    settling = settling_of(rig, plan, store)
    task = Task(
        range_deg=(low, high),
        precision=_precision(rig, unit, store),
        pace=_pace(plan, rig, settling.least_s, store),
        type_b=_type_b(rig, store, maps),
        trace=wanted.trace,
        until=wanted.until is not None,
        seed=plan.seed,
    )
    return Question(wanted, plan, task, settling)


def _pace(plan: Plan, rig: RigSettings, settle_s: float, store: Store | None) -> Pace:
    known = rig_pace(rig, store)
    travel_s = partial(known.travel_s, velocity_dps=plan.velocity_dps)
    return Pace(travel_s, settle_s, known.questions_s, known.begin_s, known.stands_deg)


def _precision(rig: RigSettings, unit: str, store: Store | None) -> Precision:
    """Of the unit's last calibration on the rig, else of the rig's last one."""
    if store is None:
        return NOT_MEASURED
    for serial in [unit, None] if unit else [None]:
        runs, _ = store.runs(rig=rig.name, unit=serial, status="completed", limit=10)
        for run in runs:
            if (found := _of_run(run)) is not None:
                return found
    return NOT_MEASURED


def _of_run(run: Run) -> Precision | None:
    result, plan = run.result, run.plan or {}
    if run.voided or not result or plan.get("kind") != "calibration" or plan.get("target_std_deg"):
        return None
    left = result["rms_with_effects_deg"] or result["rms_calibrated_deg"]
    n, noise_deg = result["n_poses"], result["noise_deg"]
    if left is None or noise_deg is None or n < 8:
        return None
    return precision_of_run(short_name(run.id), plan["dwell_s"], noise_deg, left * (n / (n - 2.0)) ** 0.5)


def _type_b(rig: RigSettings, store: Store | None, maps: Mapping[str, Document]) -> TypeB | None:
    in_force = maps.get(rig.name) if store is None else kept_of(store, rig.name, maps)
    if in_force is not None:
        return TypeB(StageMap.from_document(in_force).std_deg, None)
    stated = rig.reference
    if stated is None or stated.std_deg is None:
        return None
    return TypeB(stated.std_deg, Reference(stated.std_deg, stated.kind, stated.distribution))
