"""The quickest of many layouts that reaches what is wanted, and the time that none could be under."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calrig.calibration.early_end import caution, has_the_line
from calrig.calibration.plan_design.goals import NO_REFERENCE, Goals, TypeB, scatter_wanted_deg
from calrig.calibration.plan_design.layout import layout, leverage, way_s
from calrig.calibration.plan_design.rig_figures import Pace, Precision
from calrig.calibration.plan_design.suspects import (
    SHOWN_BY_MOVING,
    Suspect,
    least_slow_deg,
    suspects,
)
from calrig.plan import FEWEST_UNTIL

POSES = (4, 5, 6, 7, 8, 10, 12, 14, 16, 18, 20, 22, 25, 28, 32, 36, 40, 48, 60, 80, 100, 140, 200)
SWEEPS = (1, 2, 4, 6)
AT_ENDS = (0.0, 0.3, 0.6, 1.0)
SHORTEST_DWELL_S, LONGEST_DWELL_S = 0.5, 120.0
DWELL_STEP_S = 0.05
FEWEST_TRACED, SWEEPS_TRACED, AT_ENDS_TRACED = 28, 2, 0.6
"""Of a design that is to trace effects: fewer poses, no return, or all poses at the ends show none."""
TRACED_SHARE = 1.0
"""Of the uncertainty wanted, the RMS of an effect that must not stay hidden: it would not be covered."""
MOST_TRIED = 40
"""Designs whose suspects are looked at, from the quickest on: each takes some hundredths of a second."""
RESERVE = 1.25
"""Of a run that ends when it is good enough: more scatter than expected does not leave it short."""
RICH = (60, 4, 0.3)
"""Poses, sweeps and share at the ends of a design that shows what poses can show."""


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
        sweeps: how often the range is gone through.
        suspects: what it would show of each.
    """

    elevations_deg: tuple[float, ...]
    dwell_s: float
    duration_s: float
    expanded_deg: float | None
    bias_std_deg: float
    scale_std: float
    sweeps: int
    suspects: tuple[Suspect, ...] = ()


@dataclass(frozen=True, slots=True)
class Task:
    """What a design is made for: range, rig, precision of its readings, reference, effects to be traced.

    With `until` its run ends as soon as the goals are reached; its plan suffices for poses that scatter
    `reserve` times as much.
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


Told = Callable[[float], None]


def _unheard(_share: float) -> None:
    """Nobody asked how far it is."""


def quickest(task: Task, goals: Goals, told: Told = _unheard) -> Design:
    """The design of least time that reaches the goals; tells the share that is done.

    With `trace`, the first by time whose hidden effects would be smaller than half of the uncertainty wanted
    (of the scatter of a reading, where no uncertainty is named), as far as the same poses can show them.

    Raises:
        OutOfReachError: none reaches them.
    """
    found = sorted(_reaching(task, goals), key=partial(_time_s, task, goals))
    if not found and task.until and task.reserve > 1.0:
        return quickest(replace(task, reserve=1.0), goals, told)
    if not found:
        raise OutOfReachError(_why_none(task, goals))
    if not task.trace:
        return found[0]
    allowed_deg = TRACED_SHARE * (goals.expanded_deg or task.precision.scatter_deg(found[0].dwell_s))
    hidden = _always_hidden(task, found[0].dwell_s, allowed_deg)
    tried = found[:: max(1, len(found) // MOST_TRIED)]
    for done, design in enumerate(tried):
        told(done / len(tried))
        shown = _with_suspects(task, design)
        if all(s.rms_deg <= allowed_deg or s.name in hidden for s in shown.suspects):
            break
    return shown


def within(task: Task, time_s: float) -> Design:
    """The design of least uncertainty that takes no longer than a time; errors as of `quickest`."""
    found = list(_of_time(task, time_s))
    if not found:
        least_s = min(_overhead_s(task, order) for order, _ in _layouts(task)) + SHORTEST_DWELL_S
        raise OutOfReachError(
            f"{time_s:g} s are too few: the fewest poses and their moves take about {least_s:.0f} s"
        )
    best = min(found, key=lambda d: (d.expanded_deg or 0.0, d.scale_std * 60.0 + d.bias_std_deg))
    return _with_suspects(task, best) if task.trace else best


def ended(task: Task, goals: Goals, design: Design) -> Design:
    """A design as far as its run is expected to come, if that ends as soon as the goals are reached."""
    if not task.until:
        return design
    order = design.elevations_deg
    for n in range(FEWEST_UNTIL, len(order)):
        if has_the_line(order[:n], order):
            part = _design(task, list(order[:n]), design.sweeps, design.dwell_s, caution(n))
            if goals.reached_by(part.expanded_deg, part.bias_std_deg, part.scale_std):
                return part
    return design


def _time_s(task: Task, goals: Goals, design: Design) -> float:
    """What a design costs: its time, and of one that ends early as much what it may take as what it will."""
    return 0.5 * (design.duration_s + ended(task, goals, design).duration_s)


def limit_s(task: Task, goals: Goals) -> float:
    """A time that no plan of dwells is under: one way through the range, and the data where they say most.

    Two ways where effects are to be traced, which a run that may end early need not finish. The poses stand
    at the two ends and nowhere else; their number is the one for which dwells and settling are shortest.
    """
    pace, stands_s = task.pace, math.inf
    fewest, ways = (FEWEST_TRACED, SWEEPS_TRACED) if task.trace else (POSES[0], 1)
    if task.until:
        fewest, ways = FEWEST_UNTIL, 1
    traced = _traced_by(task, goals)
    for n in range(fewest, POSES[-1] + 1):
        if n * (SHORTEST_DWELL_S + pace.settle_s + pace.questions_s) > stands_s:
            break
        dwell_s = _at_the_ends_s(task, goals, n)
        if traced(n, dwell_s):
            stands_s = min(stands_s, n * (dwell_s + pace.settle_s + pace.questions_s))
    return pace.begin_s + ways * pace.travel_s(task.range_deg[1] - task.range_deg[0]) + stands_s


def _at_the_ends_s(task: Task, goals: Goals, n: int) -> float:
    """The shortest dwells with which so many poses reach the goals; infinite where none do."""
    wanted_deg = _scatter_deg(task, goals, n, leverage([task.range_deg[k % 2] for k in range(n)]))
    return max(SHORTEST_DWELL_S, task.precision.dwell_s(wanted_deg)) if wanted_deg > 0.0 else math.inf


def _traced_by(task: Task, goals: Goals) -> Callable[[int, float], bool]:
    """What tells whether so many such dwells could show effects of time of the size that is not to hide."""
    allowed_deg = TRACED_SHARE * (goals.expanded_deg or math.inf)

    def show(n: int, dwell_s: float) -> bool:
        return least_slow_deg(n, task.precision.scatter_deg(dwell_s)) <= allowed_deg

    asked = task.trace and not task.until and show(RICH[0], _at_the_ends_s(task, goals, RICH[0]))
    return lambda n, dwell_s: not asked or show(n, dwell_s)


def _layouts(task: Task) -> Iterator[tuple[list[float], int]]:
    """Every layout that is tried, in the order of visiting, with its number of sweeps."""
    for n in POSES:
        for sweeps in SWEEPS:
            for at_ends in AT_ENDS:
                if 2 * sweeps > n:
                    continue
                if task.trace and (n < FEWEST_TRACED or sweeps < SWEEPS_TRACED or at_ends > AT_ENDS_TRACED):
                    continue
                rng = np.random.default_rng([task.seed, n, sweeps, round(10 * at_ends)])
                yield layout(task.range_deg, n, sweeps, at_ends, rng), sweeps


def _reaching(task: Task, goals: Goals) -> Iterator[Design]:
    for order, sweeps in _layouts(task):
        wanted_deg = _scatter_deg(task, goals, len(order), leverage(order))
        if task.until:
            wanted_deg *= 0.0 if len(order) < FEWEST_UNTIL else 1.0 / (task.reserve * caution(len(order)))
        exact_s = task.precision.dwell_s(wanted_deg) if wanted_deg > 0.0 else math.inf
        if exact_s <= LONGEST_DWELL_S:
            dwell_s = DWELL_STEP_S * math.ceil(exact_s / DWELL_STEP_S - 1e-9)
            yield _design(task, order, sweeps, max(SHORTEST_DWELL_S, dwell_s))


def _of_time(task: Task, time_s: float) -> Iterator[Design]:
    for order, sweeps in _layouts(task):
        dwell_s = (time_s - _overhead_s(task, order)) / len(order)
        dwell_s = min(DWELL_STEP_S * math.floor(dwell_s / DWELL_STEP_S + 1e-9), LONGEST_DWELL_S)
        if dwell_s >= SHORTEST_DWELL_S:
            yield _design(task, order, sweeps, dwell_s)


def _overhead_s(task: Task, order: list[float]) -> float:
    pace = task.pace
    first_s = pace.travel_s(abs(order[0] - pace.stands_deg))
    return pace.begin_s + first_s + way_s(order, pace) + len(order) * (pace.settle_s + pace.questions_s)


def _design(task: Task, order: list[float], sweeps: int, dwell_s: float, cautioned: float = 1.0) -> Design:
    scatter_deg = cautioned * task.precision.scatter_deg(dwell_s)
    over_range, bias, scale = leverage(order)
    type_a_deg = scatter_deg * math.sqrt(1.0 + over_range)
    return Design(
        elevations_deg=tuple(order),
        dwell_s=round(dwell_s, 3),
        duration_s=_overhead_s(task, order) + len(order) * dwell_s,
        expanded_deg=None if task.type_b is None else task.type_b.expanded_deg(type_a_deg, len(order) - 2.0),
        bias_std_deg=scatter_deg * math.sqrt(bias),
        scale_std=scatter_deg * math.sqrt(scale),
        sweeps=sweeps,
    )


def _scatter_deg(task: Task, goals: Goals, n: int, leverages: tuple[float, float, float]) -> float:
    type_b = task.type_b or NO_REFERENCE
    return scatter_wanted_deg(goals, type_b, n, leverages)


def _with_suspects(task: Task, design: Design) -> Design:
    scatter_deg = task.precision.scatter_deg(design.dwell_s)
    seen = suspects(design.elevations_deg, design.dwell_s, scatter_deg, task.pace, task.names)
    return replace(design, suspects=tuple(seen))


def _always_hidden(task: Task, dwell_s: float, allowed_deg: float) -> set[str]:
    """Effects that a rich design with such dwells does not show either: no fault of another one."""
    n, sweeps, at_ends = RICH
    order = layout(task.range_deg, n, sweeps, at_ends, np.random.default_rng([task.seed, *RICH[:2]]))
    seen = suspects(order, dwell_s, task.precision.scatter_deg(dwell_s), task.pace, task.names)
    return {one.name for one in seen if one.rms_deg > allowed_deg}


def _why_none(task: Task, goals: Goals) -> str:
    least_deg = task.type_b.least_deg if task.type_b else 0.0
    if goals.expanded_deg is not None and goals.expanded_deg <= least_deg:
        return (
            f"an expanded uncertainty of {goals.expanded_deg:g}° is below what the stage's angle is worth: "
            f"{least_deg:.3g}° is left however many poses there are; a better reference reaches it: a "
            "certificate of less, or the stage's own map, which `calrig solve` finds of a unit clamped at "
            "0°, 120° and 240°"
        )
    left = ""
    if task.type_b is not None and goals.expanded_deg is not None:
        worth_deg = task.type_b.expanded_deg(task.precision.pose_deg, POSES[-1] - 2.0)
        left = f"; they leave an expanded uncertainty of about {worth_deg:.3g}°"
    return (
        f"{POSES[-1]} poses of {LONGEST_DWELL_S:g} s do not reach what is wanted, for poses scatter by "
        f"{task.precision.pose_deg:.2g}° however long each dwells ({task.precision.said}){left}; what "
        "scatters beyond noise has a cause: diagnose that run, and accept what it names"
    )
