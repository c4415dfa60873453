"""What a plan is designed for, and a design: what both of its kinds have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass

from calrig.calibration.plan_design.goals import NO_REFERENCE, Goals, TypeB, scatter_wanted_deg
from calrig.calibration.plan_design.layout import leverage
from calrig.calibration.plan_design.rig_figures import Pace, Precision, Turning
from calrig.calibration.plan_design.suspects import SHOWN_BY_MOVING, Suspect
from calrig.calibration.plan_design.sweep import Sweep

SHORTEST_DWELL_S, LONGEST_DWELL_S = 0.5, 120.0
DWELL_STEP_S = 0.01
FEWEST_TRACED = 28
"""Poses of a design that is to trace effects: of fewer a search finds none."""
RESERVE = 1.25
"""Of a run that ends when it is good enough: more scatter than expected does not leave it short."""


class OutOfReachError(ValueError):
    """No design reaches what is wanted; the message says why."""


@dataclass(frozen=True, slots=True)
class Design:
    """A design of poses and what is to be expected of it.

    Attributes:
        elevations_deg: in the order of visiting.
        dwell_s: of each pose.
        duration_s: from the beginning to the end, by the pace of the rig.
        expanded_deg: uncertainty that its result will state; None without a statement of the reference.
        bias_std_deg, scale_std: standard errors of its line.
        scatter_deg: of its readings, RMS.
        sweep: where it turns without stopping; None where all of its poses are dwells.
        suspects: what it would show of each.
    """

    elevations_deg: tuple[float, ...]
    dwell_s: float
    duration_s: float
    expanded_deg: float | None
    bias_std_deg: float
    scale_std: float
    scatter_deg: float
    sweep: Sweep | None = None
    suspects: tuple[Suspect, ...] = ()


@dataclass(frozen=True, slots=True)
class Sweeping:
    """That a rig may turn without stopping: how fast, and how precise stretches are."""

    turning: Turning
    precision: Precision


@dataclass(frozen=True, slots=True)
class Task:
    """What a design is made for: range, rig, precision of its readings, reference, effects to be traced.

    With `until` its run ends as soon as the goals are reached; its plan suffices for poses that scatter
    `reserve` times as much. `sweeping` is None where its plan has to stop for every pose.
    """

    range_deg: tuple[float, float]
    precision: Precision
    pace: Pace
    type_b: TypeB | None
    trace: bool = True
    until: bool = False
    reserve: float = RESERVE
    seed: int = 0
    names: tuple[str, ...] = SHOWN_BY_MOVING
    sweeping: Sweeping | None = None

    @property
    def begins_above(self) -> bool:
        """Whether the upper end is the nearer one to where the stage stands."""
        low, high = self.range_deg
        return abs(high - self.pace.stands_deg) < abs(low - self.pace.stands_deg)

    def scatter_wanted_deg(self, goals: Goals, order: list[float]) -> float:
        """The largest scatter of readings at these elevations with which the goals are reached."""
        return scatter_wanted_deg(goals, self.type_b or NO_REFERENCE, len(order), leverage(order))

    def stated(
        self,
        order: list[float],
        dwell_s: float,
        duration_s: float,
        scatter_deg: float,
        cautioned: float = 1.0,
        sweep: Sweep | None = None,
    ) -> Design:
        """A design and what its result will state, the scatter larger by what ending early asks for."""
        over_range, bias, scale = leverage(order)
        stated_deg = cautioned * scatter_deg
        expanded_deg: float | None = None
        if self.type_b is not None:
            type_a_deg = stated_deg * math.sqrt(1.0 + over_range)
            expanded_deg = self.type_b.of_line(over_range).expanded_deg(type_a_deg, len(order) - 2.0)
        return Design(
            elevations_deg=tuple(order),
            dwell_s=dwell_s,
            duration_s=duration_s,
            expanded_deg=expanded_deg,
            bias_std_deg=stated_deg * math.sqrt(bias),
            scale_std=stated_deg * math.sqrt(scale),
            scatter_deg=scatter_deg,
            sweep=sweep,
        )


def rounded_up_s(dwell_s: float) -> float:
    """The next time that a plan names."""
    return round(DWELL_STEP_S * math.ceil(dwell_s / DWELL_STEP_S - 1e-9), 3)


def rounded_down_s(dwell_s: float) -> float:
    """The one before."""
    return round(DWELL_STEP_S * math.floor(dwell_s / DWELL_STEP_S + 1e-9), 3)
