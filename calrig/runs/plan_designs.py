"""The plan that gets there soonest on a rig, from what the rig has shown so far: CONTRACT section 9."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

from calrig.analysis.errors import Invalid
from calrig.calibration.plan_design.design import (
    Design,
    OutOfReachError,
    Task,
    ended,
    limit_s,
    quickest,
    within,
)
from calrig.calibration.plan_design.goals import Goals, TypeB
from calrig.calibration.plan_design.rig_figures import NOT_MEASURED, Pace, Precision, precision_of_run
from calrig.calibration.plan_design.settling import SHARE, forgotten_s
from calrig.calibration.stage_reference import StageMap
from calrig.calibration.uncertainty import Reference
from calrig.plan import Plan, Until
from calrig.run_ids import short_name
from calrig.runs.rig_pace import rig_pace
from calrig.runs.settling import Settling, settling_of
from calrig.settings import RigSettings
from calrig.store import Run, Store

SETTLED_AFTER = 4
"""Designs, each with the settling that the moves of the one before ask for."""


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
class Designed:
    """A plan, what is expected of it, the time that none is under, and what to know of it.

    `whole` is the design, `design` as much of it as a run is expected to take.
    """

    plan: Plan
    design: Design
    whole: Design
    limit_s: float | None
    says: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """CONTRACT section 9's answer, and `suspects`: what would be found of each."""
        expected = self.design
        return {
            "plan": self.plan.model_dump(mode="json"),
            "expected": {
                "duration_s": expected.duration_s,
                "expanded_uncertainty_deg": expected.expanded_deg,
                "bias_std_deg": expected.bias_std_deg,
                "scale_std": expected.scale_std,
            },
            "limit": None if self.limit_s is None else {"duration_s": self.limit_s, "why": _why(self)},
            "suspects": [
                {
                    "name": one.name,
                    "title": one.title,
                    "rms_deg": one.rms_deg if one.rms_deg < 1e6 else None,
                    "parameter": one.parameter,
                    "unit": one.unit,
                    "value": one.value,
                }
                for one in self.whole.suspects
            ],
            "says": list(self.says),
        }


def designed(wanted: Wanted, plan: Plan, rig: RigSettings, unit: str, store: Store | None) -> Designed:
    """The plan for a rig and a unit.

    Args:
        wanted: what it is to reach.
        plan: what it keeps: range, rate, velocity, seed; its settling where none has been measured.
        rig: where it is to run.
        unit: of whose last run on this rig the noise is taken; else that of the last one on the rig.
        store: has the earlier runs; None where there is none yet.

    Raises:
        Invalid: it cannot be reached, and why.
    """
    low, high = min(plan.elevations()), max(plan.elevations())
    if high - low < 1.0:
        raise Invalid(f"a plan over {high - low:g}° has no scale: give it a range", ["plan.start_deg"])
    settling = settling_of(rig, plan, store)
    task = Task(
        range_deg=(low, high),
        precision=_precision(rig, unit, store),
        pace=_pace(plan, rig, settling.least_s, store),
        type_b=_type_b(rig, store),
        trace=wanted.trace,
        until=wanted.until is not None,
        seed=plan.seed,
    )
    try:
        task, whole = _settled(task, wanted, settling)
    except OutOfReachError as error:
        field = "time_s" if wanted.time_s is not None else "target_u_deg"
        raise Invalid(str(error), [field]) from error
    design = ended(task, wanted.goals, whole)
    made = plan.model_copy(
        update={
            "elevations_deg": list(whole.elevations_deg),
            "order": "given",
            "sweeps": 1,
            "jitter_deg": 0.0,
            "settle_s": task.pace.settle_s,
            "dwell_s": whole.dwell_s,
            "target_std_deg": None,
            "until": wanted.until,
        }
    )
    least_s = limit_s(task, wanted.goals) if wanted.time_s is None else None
    return Designed(made, design, whole, least_s, _says(task, design, whole, settling))


def _settled(task: Task, wanted: Wanted, settling: Settling) -> tuple[Task, Design]:
    """The design that waits long enough for the filter to forget its own moves."""
    for _ in range(SETTLED_AFTER):
        design = quickest(task, wanted.goals) if wanted.time_s is None else within(task, wanted.time_s)
        if settling.gyro is None:
            return task, design
        pace, order = task.pace, design.elevations_deg
        moves_s = [pace.travel_s(abs(after - before)) for before, after in pairwise((order[0], *order))]
        wanted_deg = wanted.goals.expanded_deg or 2.0 * task.precision.scatter_deg(design.dwell_s)
        needed_s = forgotten_s(order, moves_s, design.dwell_s, settling.gyro, SHARE * wanted_deg)
        if needed_s <= pace.settle_s:
            return task, design
        task = replace(task, pace=replace(pace, settle_s=needed_s))
    return task, design


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


def _type_b(rig: RigSettings, store: Store | None) -> TypeB | None:
    in_force = None if store is None else store.stage_map(rig.name)
    if in_force is not None:
        return TypeB(StageMap.from_document(in_force.document).std_deg, None)
    stated = rig.reference
    if stated is None or stated.std_deg is None:
        return None
    return TypeB(stated.std_deg, Reference(stated.std_deg, stated.kind, stated.distribution))


def _why(made: Designed) -> str:
    twice = made.whole.suspects and made.plan.until is None
    ways = "two ways through the range" if twice else "one way through the range"
    return f"{ways}, and dwells at its two ends alone: less time does not hold the data"


def _says(task: Task, design: Design, whole: Design, settling: Settling) -> tuple[str, ...]:
    said = [f"{task.precision.said[0].upper()}{task.precision.said[1:]}."]
    waits_s = task.pace.settle_s
    because = "" if waits_s <= settling.least_s else ", and the filter has forgotten the moves"
    said.append(f"It waits {waits_s:g} s after each move: {settling.said}{because}.")
    if task.type_b is None:
        said.append(
            "The rig says of no reference what its angle is worth, so that no expanded uncertainty is known."
        )
    if task.until:
        said.append(
            f"It ends as soon as that is reached: after about {len(design.elevations_deg)} of its "
            f"{len(whole.elevations_deg)} poses where readings scatter as before, and after "
            f"{whole.duration_s:.0f} s at most."
            + (" What it would show of effects is told for all of its poses." if task.trace else "")
        )
    shown = [one for one in whole.suspects if one.rms_deg < 1e6]
    if shown:
        least = max(shown, key=lambda one: one.rms_deg)
        said.append(
            f"Of the effects that moving shows, each that leaves {least.rms_deg:.2g}° (RMS) or more in "
            f"calibrated readings would be found about four times in five; the hardest is: {least.title}."
        )
    elif not task.trace:
        said.append("Effects are not to be traced: what bends between the ends stays unseen.")
    return tuple(said)
