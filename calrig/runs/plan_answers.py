"""The plan for what was asked, found from what is known of the rig: pure work, for a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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
from calrig.calibration.plan_design.settling import SHARE, forgotten_s
from calrig.plan import Plan
from calrig.runs.plan_designs import Question, Wanted
from calrig.runs.settling import Settling

SETTLED_AFTER = 4
"""Designs, each with the settling that the moves of the one before ask for."""


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
    made = asked.plan.model_copy(
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
    return Designed(made, design, whole, least_s, _says(task, design, whole, asked.settling))


def _settled(
    task: Task, wanted: Wanted, settling: Settling, progress: Callable[[float], None]
) -> tuple[Task, Design]:
    """The design that waits long enough for the filter to forget its own moves."""
    for done in range(SETTLED_AFTER):

        def told(share: float, done: int = done) -> None:
            progress((done + share) / SETTLED_AFTER)

        time_s = wanted.time_s
        design = quickest(task, wanted.goals, told) if time_s is None else within(task, time_s)
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
