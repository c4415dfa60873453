"""Designs that turn without stopping, where the rig may."""

import math
from collections.abc import Iterator
from dataclasses import replace

from calrig.calibration.plan_design.design_problem import (
    DWELL_STEP_S,
    FEWEST_TRACED,
    LONGEST_DWELL_S,
    Design,
    DesignProblem,
    Goals,
    Sweeping,
    rounded_down_s,
    rounded_up_s,
)
from calrig.calibration.plan_design.layout import Sweep, least_stretch_s, sweeps
from calrig.calibration.uncertainty.sequential_stopping import caution
from calrig.model.plan import FEWEST_UNTIL


def reaching(task: DesignProblem, goals: Goals) -> Iterator[Design]:
    """Those that reach the goals, turning as fast as that allows; none where the rig may not."""
    if task.sweeping is None:
        return
    for sweep in _tried(task):
        order = sweep.elevations_deg()
        wanted_deg = task.scatter_wanted_deg(goals, order)
        if task.until:
            wanted_deg *= 0.0 if len(order) < FEWEST_UNTIL else 1.0 / (task.reserve * caution(len(order)))
        least_s = rounded_up_s(least_stretch_s(sweep, task.sweeping.turning))
        stretch_s = _stretch_s(sweep, wanted_deg, least_s, task.sweeping)
        if stretch_s <= LONGEST_DWELL_S:
            yield made(task, task.sweeping, replace(sweep, stretch_s=stretch_s))


def of_time(task: DesignProblem, time_s: float) -> Iterator[Design]:
    """Those that take no longer than a time, turning as slowly as that allows."""
    if task.sweeping is None:
        return
    turning = task.sweeping.turning
    for sweep in _tried(task):
        beside_s = sweep.duration_s(task.pace, turning) - len(sweep) * sweep.stretch_s
        stretch_s = rounded_down_s((time_s - beside_s) / len(sweep))
        stretch_s = min(stretch_s, LONGEST_DWELL_S)
        slower = replace(sweep, stretch_s=stretch_s)
        if stretch_s >= least_stretch_s(sweep, turning) and slower.duration_s(task.pace, turning) <= time_s:
            yield made(task, task.sweeping, slower)


def least_s(task: DesignProblem) -> float:
    """What the quickest of them takes; infinite where the rig may not sweep."""
    if task.sweeping is None:
        return math.inf
    turning = task.sweeping.turning
    shortest = (replace(one, stretch_s=rounded_up_s(least_stretch_s(one, turning))) for one in _tried(task))
    return min((one.duration_s(task.pace, turning) for one in shortest), default=math.inf)


def parts(task: DesignProblem, sweeping: Sweeping, design: Design, sweep: Sweep) -> Iterator[Design]:
    """As many passes of a design, a way and back at least, as its run has made each time it may end early."""
    for passes in range(2, sweep.passes):
        begun = replace(sweep, passes=passes)
        order = list(design.elevations_deg[: len(begun)])
        if len(order) >= FEWEST_UNTIL:
            yield _stated(task, sweeping, begun, order, caution(len(order)))


def made(task: DesignProblem, sweeping: Sweeping, sweep: Sweep) -> Design:
    """The design of a sweep."""
    return _stated(task, sweeping, sweep, sweep.elevations_deg(), 1.0)


def _stated(
    task: DesignProblem, sweeping: Sweeping, sweep: Sweep, order: list[float], cautioned: float
) -> Design:
    scatter_deg = sweep.scatter_deg(sweeping.precision, sweeping.turning)
    duration_s = sweep.duration_s(task.pace, sweeping.turning)
    return task.stated(order, sweep.stretch_s, duration_s, scatter_deg, cautioned, sweep)


def _tried(task: DesignProblem) -> Iterator[Sweep]:
    low, high = task.range_deg
    ends_deg = (high, low) if task.begins_above else (low, high)
    return sweeps(ends_deg, FEWEST_TRACED if task.trace else 0)


def _stretch_s(sweep: Sweep, wanted_deg: float, least_s: float, sweeping: Sweeping) -> float:
    """The shortest stretches that scatter no more than is wanted; beyond `LONGEST_DWELL_S` where none do."""

    def suffice(steps: int) -> bool:
        slower = replace(sweep, stretch_s=least_s + steps * DWELL_STEP_S)
        return slower.scatter_deg(sweeping.precision, sweeping.turning) <= wanted_deg

    low, high = 0, round(LONGEST_DWELL_S / DWELL_STEP_S)
    if not suffice(high):
        return 2.0 * LONGEST_DWELL_S
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if suffice(middle) else (middle + 1, high)
    return rounded_up_s(least_s + low * DWELL_STEP_S)
