"""The plan that gets there soonest on a rig, from what the rig has shown so far: CONTRACT section 9."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from calrig.analysis.errors import Invalid
from calrig.calibration.plan_design.design import Design, OutOfReachError, Task, limit_s, quickest, within
from calrig.calibration.plan_design.goals import Goals, TypeB
from calrig.calibration.plan_design.rig_figures import NOT_MEASURED, Pace, Precision, precision_of_run
from calrig.calibration.stage_reference import StageMap
from calrig.calibration.uncertainty import Reference
from calrig.instruments.axis_goal import travel_time_s
from calrig.plan import Plan
from calrig.runs.planned import HOMING_AND_START_S, QUESTIONS_S, speed
from calrig.settings import RigSettings
from calrig.store import Run, Store


@dataclass(frozen=True, slots=True)
class Wanted:
    """What somebody asks of a plan: an expanded uncertainty, standard errors, or what a time is worth."""

    goals: Goals
    time_s: float | None = None
    trace: bool = True


@dataclass(frozen=True, slots=True)
class Designed:
    """A plan, what is expected of it, the time that none is under, and what to know of it."""

    plan: Plan
    design: Design
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
            "limit": None if self.limit_s is None else {"duration_s": self.limit_s, "why": _why(expected)},
            "suspects": [
                {
                    "name": one.name,
                    "title": one.title,
                    "rms_deg": one.rms_deg if one.rms_deg < 1e6 else None,
                    "parameter": one.parameter,
                    "unit": one.unit,
                    "value": one.value,
                }
                for one in expected.suspects
            ],
            "says": list(self.says),
        }


def designed(wanted: Wanted, plan: Plan, rig: RigSettings, unit: str, store: Store | None) -> Designed:
    """The plan for a rig and a unit.

    Args:
        wanted: what it is to reach.
        plan: what it keeps: range, settling, rate, velocity, seed.
        rig: where it is to run.
        unit: of whose last run on this rig the noise is taken; else that of the last one on the rig.
        store: has the earlier runs; None where there is none yet.

    Raises:
        Invalid: it cannot be reached, and why.
    """
    low, high = min(plan.elevations()), max(plan.elevations())
    if high - low < 1.0:
        raise Invalid(f"a plan over {high - low:g}° has no scale: give it a range", ["plan.start_deg"])
    task = Task(
        range_deg=(low, high),
        precision=_precision(rig, unit, store),
        pace=_pace(plan, rig, store),
        type_b=_type_b(rig, store),
        trace=wanted.trace,
        seed=plan.seed,
    )
    try:
        if wanted.time_s is None:
            design, least_s = quickest(task, wanted.goals), limit_s(task, wanted.goals)
        else:
            design, least_s = within(task, wanted.time_s), None
    except OutOfReachError as error:
        field = "time_s" if wanted.time_s is not None else "target_u_deg"
        raise Invalid(str(error), [field]) from error
    made = plan.model_copy(
        update={
            "elevations_deg": list(design.elevations_deg),
            "order": "given",
            "sweeps": 1,
            "jitter_deg": 0.0,
            "dwell_s": design.dwell_s,
            "target_std_deg": None,
        }
    )
    return Designed(made, design, least_s, _says(task, design))


def _pace(plan: Plan, rig: RigSettings, store: Store | None) -> Pace:
    velocity_dps, acceleration_dps2 = speed(rig, store)
    moves = partial(
        travel_time_s, velocity_dps=plan.velocity_dps or velocity_dps, acceleration_dps2=acceleration_dps2
    )
    return Pace(moves, plan.settle_s, QUESTIONS_S, HOMING_AND_START_S)


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
    return precision_of_run(run.id, plan["dwell_s"], noise_deg, left * (n / (n - 2.0)) ** 0.5)


def _type_b(rig: RigSettings, store: Store | None) -> TypeB | None:
    in_force = None if store is None else store.stage_map(rig.name)
    if in_force is not None:
        return TypeB(StageMap.from_document(in_force.document).std_deg, None)
    stated = rig.reference
    if stated is None or stated.std_deg is None:
        return None
    return TypeB(stated.std_deg, Reference(stated.std_deg, stated.kind, stated.distribution))


def _why(design: Design) -> str:
    ways = "two ways through the range" if design.suspects else "one way through the range"
    return f"{ways}, and dwells at its two ends alone: less time does not hold the data"


def _says(task: Task, design: Design) -> tuple[str, ...]:
    said = [f"{task.precision.said[0].upper()}{task.precision.said[1:]}."]
    if task.type_b is None:
        said.append(
            "The rig says of no reference what its angle is worth, so that no expanded uncertainty is known."
        )
    shown = [one for one in design.suspects if one.rms_deg < 1e6]
    if shown:
        least = max(shown, key=lambda one: one.rms_deg)
        said.append(
            f"Of the effects that moving shows, each that leaves {least.rms_deg:.2g}° (RMS) or more in "
            f"calibrated readings would be found about four times in five; the hardest is: {least.title}."
        )
    elif not task.trace:
        said.append("Effects are not to be traced: what bends between the ends stays unseen.")
    return tuple(said)
