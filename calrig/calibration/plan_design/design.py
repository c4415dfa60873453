"""The quickest of many designs that reaches what is wanted, or the best one for a time."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from calrig.calibration.plan_design import dwell_designs, sweep_designs
from calrig.calibration.plan_design.goals import Goals
from calrig.calibration.plan_design.layout import BEST_OVER_RANGE
from calrig.calibration.plan_design.task import (
    LONGEST_DWELL_S,
    Design,
    OutOfReachError,
    Task,
)
from calrig.calibration.plan_design.traced import could_show_enough, excess_of, with_suspects
from calrig.calibration.progress import Progress, unheard

MOST_POSES = dwell_designs.POSES[-1]
MOST_TRIED = 40
"""Designs whose suspects are looked at, most of them among the quickest."""


def quickest(task: Task, goals: Goals, told: Progress = unheard) -> Design:
    """The design of least time that reaches the goals; tells the share that is done.

    With `trace`, the first by time that hides no more of an effect than is allowed (`traced.allowed_deg`), as
    far as such poses can show it; the one that hides least, where all hide more.

    Raises:
        OutOfReachError: none reaches them.
    """
    reaching = [*dwell_designs.reaching(task, goals), *sweep_designs.reaching(task, goals)]
    found = sorted(reaching, key=partial(_time_s, task, goals))
    if not found and task.until and task.reserve > 1.0:
        return quickest(replace(task, reserve=1.0), goals, told)
    if not found:
        raise OutOfReachError(_why_none(task, goals))
    if not task.trace:
        return found[0]
    excess = excess_of(task, goals, found[0])
    able = could_show_enough(task, goals, found)
    places = np.unique(np.geomspace(1, len(able), MOST_TRIED).astype(int)) - 1
    tried = [able[place] for place in places]
    shown: list[Design] = []
    for done, design in enumerate(tried):
        told(done / len(tried))
        shown.append(with_suspects(task, design))
        if excess(shown[-1]) <= 1.0:
            return shown[-1]
    return min(shown, key=excess)


def within(task: Task, time_s: float) -> Design:
    """The design of least uncertainty that takes no longer than a time; errors as of `quickest`."""
    found = [*dwell_designs.of_time(task, time_s), *sweep_designs.of_time(task, time_s)]
    if not found:
        least_s = min(dwell_designs.least_s(task), sweep_designs.least_s(task))
        raise OutOfReachError(
            f"{time_s:g} s are too few: the fewest poses and their moves take {math.ceil(least_s)} s"
        )
    best = min(found, key=lambda d: (d.expanded_deg or 0.0, d.scale_std * 60.0 + d.bias_std_deg))
    return with_suspects(task, best) if task.trace else best


def ended(task: Task, goals: Goals, design: Design) -> Design:
    """A design as far as its run is expected to come, if that ends as soon as the goals are reached."""
    if not task.until:
        return design
    if design.sweep is not None and task.sweeping is not None:
        return sweep_designs.first_good_enough(task, task.sweeping, goals, design, design.sweep)
    return dwell_designs.first_good_enough(task, goals, design)


def _time_s(task: Task, goals: Goals, design: Design) -> float:
    """What a design costs: its time, and of one that ends early as much what it may take as what it will."""
    return 0.5 * (design.duration_s + ended(task, goals, design).duration_s)


def _why_none(task: Task, goals: Goals) -> str:
    if task.type_b is not None and (beyond := task.type_b.why_beyond(goals)) is not None:
        return beyond
    left = ""
    if task.type_b is not None and goals.expanded_deg is not None:
        type_b = task.type_b.of_line(BEST_OVER_RANGE / MOST_POSES)
        worth_deg = type_b.expanded_deg(task.precision.pose_deg, MOST_POSES - 2.0)
        left = f"; they leave an expanded uncertainty of about {worth_deg:.3g}°"
    return (
        f"{MOST_POSES} poses of {LONGEST_DWELL_S:g} s do not reach what is wanted, for poses scatter by "
        f"{task.precision.pose_deg:.2g}° however long each dwells ({task.precision.said}){left}; what "
        "scatters beyond noise has a cause: diagnose that run, and accept what it names"
    )
