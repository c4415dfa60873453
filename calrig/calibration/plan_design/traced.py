"""What a design would show of effects, and how much of one may stay hidden."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.plan_design.design_problem import NO_REFERENCE, Design, DesignProblem, Goals
from calrig.calibration.plan_design.layout import Sweep, layout, leverage
from calrig.calibration.plan_design.smallest_effects import (
    imagined_dwells,
    imagined_sweep,
    least_slow_deg,
    suspects,
)
from calrig.calibration.plan_design.sweep_designs import made as swept
from calrig.model.plan import LONGEST_STRETCH_DEG, Plan

STANDARD_DEG = tuple(pose.target_deg for pose in Plan().poses((-90.0, 90.0)))
"""Of the default plan: what it shows beside the same noise is what a design is to show that may sweep."""
ITS_DRIFT = 1.031
"""Times `least_slow_deg`: what it shows of a drift, over any range and at any velocity."""
RICH = (60, 4, 0.3)
"""Poses, sweeps and share at the ends of a design that shows what dwells can show."""
RICH_SWEEP = (4, 14)
"""Passes and stretches of one that shows what stretches can show."""
ONLY_DWELLS_SHOW = ("settling",)
"""Effects of what goes on once a move has ended."""


def with_suspects(task: DesignProblem, design: Design) -> Design:
    """The design, with what it would show."""
    poses = (
        imagined_dwells(design.elevations_deg, design.dwell_s, task.pace)
        if design.sweep is None or task.sweeping is None
        else imagined_sweep(design.sweep, task.pace, task.sweeping.turning, task.seed)
    )
    if design.sweep is None:
        return replace(design, suspects=tuple(suspects(poses, design.scatter_deg, task.names)))
    return replace(design, suspects=tuple(suspects(poses, design.scatter_deg, task.names, ONLY_DWELLS_SHOW)))


def allowed_deg(task: DesignProblem, goals: Goals, scatter_deg: float) -> float:
    """RMS of an effect that may stay hidden.

    As large as the uncertainty wanted: more would not be covered. Where the rig may sweep, there is time for
    more: no more than the default plan too leaves hidden of a drift, its readings as uncertain as is wanted.

    Args:
        task: for what.
        goals: wanted.
        scatter_deg: of readings, where no uncertainty is named.
    """
    wanted_deg = goals.expanded_deg
    if task.sweeping is None:
        return scatter_deg if wanted_deg is None else wanted_deg
    n = len(STANDARD_DEG)
    if wanted_deg is not None:
        over_range = leverage(list(STANDARD_DEG))[0]
        type_b = (task.type_b or NO_REFERENCE).of_line(over_range)
        scatter_deg = type_b.type_a_deg(wanted_deg, n - 2.0) / math.sqrt(1.0 + over_range)
    return ITS_DRIFT * least_slow_deg(n, scatter_deg)


def could_show_enough(task: DesignProblem, goals: Goals, found: Sequence[Design]) -> Sequence[Design]:
    """Those that have poses enough for effects of time; all, where none has."""
    allowed = allowed_deg(task, goals, found[0].scatter_deg)
    able = [one for one in found if least_slow_deg(len(one.elevations_deg), one.scatter_deg) <= allowed]
    return able or found


def excess_of(task: DesignProblem, goals: Goals, first: Design) -> Callable[[Design], float]:
    """What tells how much more a design with its suspects hides than is allowed, as far as any shows it.

    That is the largest share of what is allowed; 1 and less is enough.

    Args:
        task: for what.
        goals: wanted.
        first: the quickest design that reaches them.
    """
    allowed = allowed_deg(task, goals, first.scatter_deg)
    never: dict[bool, set[str]] = {}

    def excess(design: Design) -> float:
        turns = design.sweep is not None
        if turns not in never:
            rich = with_suspects(task, _rich(task, first.dwell_s, design.sweep))
            never[turns] = {one.name for one in rich.suspects if one.rms_deg > allowed}
        shares = (one.rms_deg / allowed for one in design.suspects if one.name not in never[turns])
        return max(shares, default=0.0)

    return excess


def _rich(task: DesignProblem, dwell_s: float, sweep: Sweep | None) -> Design:
    """A design that shows what such designs can show: what it hides is no fault of another one."""
    if sweep is not None and task.sweeping is not None:
        passes, least = RICH_SWEEP
        stretches = max(least, math.ceil(sweep.way_deg / LONGEST_STRETCH_DEG))
        return swept(task, task.sweeping, replace(sweep, passes=passes, stretches=stretches))
    n, sweeps, at_ends = RICH
    order = layout(task.range_deg, n, sweeps, at_ends, np.random.default_rng([task.seed, *RICH[:2]]))
    return task.stated(order, dwell_s, math.nan, task.precision.scatter_deg(dwell_s))
