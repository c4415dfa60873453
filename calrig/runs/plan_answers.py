"""The plan for what was asked, found from what is known of the rig: pure work, for a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from pydantic import ValidationError

from calrig.analysis.errors import Invalid
from calrig.calibration.plan_design import (
    SHARE,
    Design,
    DesignProblem,
    Goals,
    OutOfReachError,
    ended,
    forgotten_s,
    limit_s,
    quickest,
    within,
)
from calrig.plan import Plan
from calrig.runs.plan_designs import Question, Wanted
from calrig.runs.settling import Settling

SETTLED_AFTER = 4
"""Designs, each with the settling that the moves of the one before ask for."""


@dataclass(frozen=True, slots=True)
class Designed:
    """A plan, what is expected of it, the time that none is under, and what to know of it.

    `whole` is the design, `design` as much of it as a run is expected to take. Of a plan for a time, no plan
    reaches as much in less than `limit_s`.
    """

    plan: Plan
    design: Design
    whole: Design
    limit_s: float
    says: tuple[str, ...]
    may_sweep: bool = False
    for_a_time: bool = False

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
            "limit": {"duration_s": self.limit_s, "why": _why(self)},
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


def answer(asked: Question, progress: Callable[[float], None] = lambda _: None) -> Designed:
    """The plan that was asked for.

    Args:
        asked: with all that is known of the rig.
        progress: is told the share that is done.

    Raises:
        Invalid: it cannot be reached, and why.
    """
    wanted = asked.wanted
    try:
        task, whole = _settled(asked.task, wanted, asked.settling, progress)
    except OutOfReachError as error:
        field = "time_s" if wanted.time_s is not None else "target_u_deg"
        raise Invalid(str(error), [field]) from error
    design = ended(task, wanted.goals, whole)
    made = _plan_of(asked, task, whole)
    least_s = _limit_s(task, wanted, whole)
    says = _says(asked, task, design, whole)
    return Designed(made, design, whole, least_s, says, task.sweeping is not None, wanted.time_s is not None)


def _limit_s(task: DesignProblem, wanted: Wanted, design: Design) -> float:
    """The time that no plan for what is wanted is under; for a time, none that reaches as much in less."""
    if wanted.time_s is None:
        return limit_s(task, wanted.goals)
    reached = Goals(design.expanded_deg, design.bias_std_deg, design.scale_std)
    return limit_s(task, reached, must_show=False)


def _plan_of(asked: Question, task: DesignProblem, design: Design) -> Plan:
    """What is kept, with the design in it."""
    common = {
        **asked.plan.model_dump(),
        "settle_s": task.pace.settle_s,
        "dwell_s": design.dwell_s,
        "target_std_deg": None,
        "until": asked.wanted.until,
    }
    sweep, was_sweep = design.sweep, asked.plan.kind == "sweep"
    if sweep is None:
        of_dwells = {
            "kind": "calibration" if was_sweep else asked.plan.kind,
            "velocity_dps": None if was_sweep else asked.plan.velocity_dps,
            "elevations_deg": list(design.elevations_deg),
            "order": "given",
            "sweeps": 1,
            "jitter_deg": 0.0,
        }
        return _valid({**common, **of_dwells})
    turning = sweep.plan(task.seed).model_dump(exclude_unset=True)
    return _valid({**common, "elevations_deg": None, "order": "sweep", **turning})


def _valid(fields: dict[str, Any]) -> Plan:
    try:
        return Plan.model_validate(fields)
    except ValidationError as error:  # what is kept goes with no such plan
        raise Invalid(error.errors()[0]["msg"].removeprefix("Value error, "), ["plan"]) from error


def _settled(
    task: DesignProblem, wanted: Wanted, settling: Settling, progress: Callable[[float], None]
) -> tuple[DesignProblem, Design]:
    """The design that waits long enough for the filter to forget its own moves."""
    for done in range(SETTLED_AFTER):

        def told(share: float, done: int = done) -> None:
            progress((done + share) / SETTLED_AFTER)

        time_s = wanted.time_s
        design = quickest(task, wanted.goals, told) if time_s is None else within(task, time_s)
        if settling.gyro is None:
            return task, design
        pace, order = task.pace, _stops_deg(design)
        moves_s = [pace.travel_s(abs(after - before)) for before, after in pairwise((order[0], *order))]
        wanted_deg = wanted.goals.expanded_deg or 2.0 * task.precision.scatter_deg(design.dwell_s)
        needed_s = forgotten_s(order, moves_s, design.dwell_s, settling.gyro, SHARE * wanted_deg)
        if needed_s <= pace.settle_s:
            return task, design
        task = replace(task, pace=replace(pace, settle_s=needed_s))
    return task, design


def _stops_deg(design: Design) -> tuple[float, ...]:
    """Where it stops, in the order of visiting."""
    if design.sweep is None:
        return design.elevations_deg
    return tuple(pose.target_deg for pose in design.sweep.poses() if pose.stretch_deg is None)


def _why(made: Designed) -> str:
    data = "the data that this plan's uncertainty needs" if made.for_a_time else "the data that are needed"
    if made.may_sweep:
        return f"{data}, taken all of the time and where they say most"
    twice = made.whole.suspects and made.plan.until is None
    ways = "two ways through the range" if twice else "one way through the range"
    return f"{ways}, and dwells at its two ends alone: less time does not hold {data}"


def _says(asked: Question, task: DesignProblem, design: Design, whole: Design) -> tuple[str, ...]:
    precision = task.sweeping.precision if task.sweeping and whole.sweep else task.precision
    said = [f"{precision.said[0].upper()}{precision.said[1:]}.", *_how_it_moves(asked, task, whole)]
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
            f"calibrated readings would be detected with a power of some 80 %; the hardest is: {least.title}."
        )
        said += [f"{one.title} is shown by dwells alone." for one in whole.suspects if one not in shown]
    elif not task.trace:
        said.append("Effects are not to be traced: what bends between the ends stays unseen.")
    return tuple(said)


def _how_it_moves(asked: Question, task: DesignProblem, whole: Design) -> list[str]:
    waits_s, settling = task.pace.settle_s, asked.settling
    because = "" if waits_s <= settling.least_s else ", and the filter has forgotten the moves"
    waits = f"It waits {waits_s:g} s after each move: {settling.said}{because}."
    if whole.sweep is not None:
        return [
            f"It turns {whole.sweep.passes} times through the range at {whole.sweep.velocity_dps:.3g}°/s "
            "without stopping; its run is refused where the motor's vibration biases the accelerometer.",
            waits.replace("each move", "each pass"),
        ]
    return [waits] if asked.no_sweep is None else [waits, f"It stops for each pose: {asked.no_sweep}."]
