"""Designs that stop for every pose."""

import math
from collections.abc import Iterator

import numpy as np

from calrig.calibration.plan_design.design_problem import (
    FEWEST_TRACED,
    LONGEST_DWELL_S,
    SHORTEST_DWELL_S,
    Design,
    DesignProblem,
    Goals,
    rounded_down_s,
    rounded_up_s,
)
from calrig.calibration.plan_design.layout import DECIMALS, layout, way_s
from calrig.calibration.uncertainty.sequential_stopping import caution, has_the_line
from calrig.model.plan import FEWEST_UNTIL

POSES = (4, 5, 6, 7, 8, 10, 12, 14, 16, 18, 20, 22, 25, 28, 32, 36, 40, 44, 48, 52, 56, 60, 80, 100, 140, 200)
SWEEPS = (1, 2, 4, 6)
AT_ENDS = (0.0, 0.3, 0.6, 1.0)
SWEEPS_TRACED, AT_ENDS_TRACED = 2, 0.6
"""Of a design that is to trace effects: without a return, or with all poses at the ends, it shows none."""


def layouts(task: DesignProblem) -> Iterator[list[float]]:
    """Every layout that is tried, in the order of visiting: from the end that is nearer to the stage."""
    low, high = task.range_deg
    for n in POSES:
        for sweeps in SWEEPS:
            for at_ends in AT_ENDS:
                if 2 * sweeps > n:
                    continue
                if task.trace and (n < FEWEST_TRACED or sweeps < SWEEPS_TRACED or at_ends > AT_ENDS_TRACED):
                    continue
                rng = np.random.default_rng([task.seed, n, sweeps, round(10 * at_ends)])
                order = layout(task.range_deg, n, sweeps, at_ends, rng)
                yield [round(low + high - one, DECIMALS) for one in order] if task.begins_above else order


def reaching(task: DesignProblem, goals: Goals) -> Iterator[Design]:
    """Those that reach the goals, their dwells as short as that allows."""
    for order in layouts(task):
        wanted_deg = task.scatter_wanted_deg(goals, order)
        if task.until:
            wanted_deg *= 0.0 if len(order) < FEWEST_UNTIL else 1.0 / (task.reserve * caution(len(order)))
        exact_s = task.precision.dwell_s(wanted_deg) if wanted_deg > 0.0 else math.inf
        if exact_s <= LONGEST_DWELL_S:
            yield made(task, order, max(SHORTEST_DWELL_S, rounded_up_s(exact_s)))


def of_time(task: DesignProblem, time_s: float) -> Iterator[Design]:
    """Those that take no longer than a time, their dwells as long as that allows."""
    for order in layouts(task):
        dwell_s = rounded_down_s((time_s - overhead_s(task, order)) / len(order))
        if dwell_s >= SHORTEST_DWELL_S:
            yield made(task, order, min(dwell_s, LONGEST_DWELL_S))


def least_s(task: DesignProblem) -> float:
    """What the quickest of them takes."""
    return min(overhead_s(task, order) + len(order) * SHORTEST_DWELL_S for order in layouts(task))


def parts(task: DesignProblem, design: Design) -> Iterator[Design]:
    """As much of a design as its run has taken each time that it may end early."""
    order = design.elevations_deg
    for n in range(FEWEST_UNTIL, len(order)):
        if has_the_line(order[:n], order):
            yield made(task, list(order[:n]), design.dwell_s, caution(n))


def overhead_s(task: DesignProblem, order: list[float]) -> float:
    """What a layout takes beside its dwells."""
    pace = task.pace
    first_s = pace.travel_s(abs(order[0] - pace.stands_deg))
    return pace.begin_s + first_s + way_s(order, pace) + len(order) * (pace.settle_s + pace.questions_s)


def made(task: DesignProblem, order: list[float], dwell_s: float, cautioned: float = 1.0) -> Design:
    """The design of a layout, all of its dwells so long."""
    duration_s = overhead_s(task, order) + len(order) * dwell_s
    return task.stated(order, dwell_s, duration_s, task.precision.scatter_deg(dwell_s), cautioned)
