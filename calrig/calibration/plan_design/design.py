"""Find the quickest design that reaches its goals, the best one for a time, and the limit of all designs."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from calrig.calibration.plan_design import dwell_designs, sweep_designs
from calrig.calibration.plan_design.design_problem import (
    FEWEST_TRACED,
    LONGEST_DWELL_S,
    NO_REFERENCE,
    SHORTEST_DWELL_S,
    Design,
    DesignProblem,
    Goals,
    OutOfReachError,
    scatter_wanted_deg,
)
from calrig.calibration.plan_design.dwell_designs import POSES
from calrig.calibration.plan_design.layout import (
    BEST_OVER_RANGE,
    PASSES,
    Precision,
    Sweep,
    layout,
    least_stretch_s,
    leverage,
)
from calrig.calibration.plan_design.smallest_effects import (
    imagined_dwells,
    imagined_sweep,
    least_slow_deg,
    suspects,
)
from calrig.calibration.progress import Progress, unheard
from calrig.calibration.uncertainty.sequential_stopping import caution
from calrig.model.plan import FEWEST_UNTIL, FIRST_SETTLE_S, LONGEST_STRETCH_DEG, Plan

MOST_POSES = dwell_designs.POSES[-1]
DRAWS = 4000
"""Runs of white noise whose time is averaged: the mean is good to 1 %."""
MOST_TRIED = 40
"""Designs whose suspects are looked at, most of them among the quickest."""

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


def quickest(task: DesignProblem, goals: Goals, told: Progress = unheard) -> Design:
    """The design of least time that reaches the goals; tells the share that is done.

    With `trace`, the first by time that hides no more of an effect than is allowed (`allowed_deg`), as
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


def within(task: DesignProblem, time_s: float) -> Design:
    """The design of least uncertainty that takes no longer than a time; errors as of `quickest`."""
    found = [*dwell_designs.of_time(task, time_s), *sweep_designs.of_time(task, time_s)]
    if not found:
        least_s = min(dwell_designs.least_s(task), sweep_designs.least_s(task))
        raise OutOfReachError(
            f"{time_s:g} s are too few: the fewest poses and their moves take {math.ceil(least_s)} s"
        )
    best = min(found, key=lambda d: (d.expanded_deg or 0.0, d.scale_std * 60.0 + d.bias_std_deg))
    return with_suspects(task, best) if task.trace else best


def ended(task: DesignProblem, goals: Goals, design: Design) -> Design:
    """A design as far as its run is expected to come, if that ends as soon as the goals are reached.

    Its number of poses, its time and its uncertainties are means over runs whose readings scatter by chance.
    """
    if not task.until:
        return design
    parts = [*_parts(task, design), design]
    n_poses = np.array([len(part.elevations_deg) for part in parts])
    freedom = n_poses - 2
    allowed = [
        task.scatter_wanted_deg(goals, list(part.elevations_deg))
        / (caution(len(part.elevations_deg)) * part.scatter_deg)
        for part in parts
    ]
    squares = np.random.default_rng(0).standard_normal((DRAWS, freedom[-1])) ** 2
    scatter = np.sqrt(np.cumsum(squares, axis=1)[:, freedom - 1] / freedom)
    is_end = scatter <= allowed
    is_end[:, -1] = True
    end = is_end.argmax(axis=1)
    counts = np.bincount(end, minlength=len(parts))
    sums = np.bincount(end, scatter[np.arange(DRAWS), end], minlength=len(parts))
    stated = [
        (task.restated(parts[k], sums[k] / counts[k], caution(int(n_poses[k]))), counts[k] / DRAWS)
        for k in np.flatnonzero(counts)
    ]
    expanded = [(part.expanded_deg, share) for part, share in stated]
    return replace(
        design,
        elevations_deg=design.elevations_deg[: round(float(n_poses[end].mean()))],
        duration_s=float(sum(share * part.duration_s for part, share in stated)),
        expanded_deg=None
        if task.type_b is None
        else float(sum(share * (of or 0.0) for of, share in expanded)),
        bias_std_deg=float(sum(share * part.bias_std_deg for part, share in stated)),
        scale_std=float(sum(share * part.scale_std for part, share in stated)),
    )


def _parts(task: DesignProblem, design: Design) -> Iterator[Design]:
    if design.sweep is not None and task.sweeping is not None:
        return sweep_designs.parts(task, task.sweeping, design, design.sweep)
    return dwell_designs.parts(task, design)


def _time_s(task: DesignProblem, goals: Goals, design: Design) -> float:
    """What a design costs: its time, and of one that ends early as much what it may take as the least."""
    if not task.until:
        return design.duration_s
    least_s = (
        part.duration_s
        for part in _parts(task, design)
        if goals.reached_by(part.expanded_deg, part.bias_std_deg, part.scale_std)
    )
    return 0.5 * (design.duration_s + next(least_s, design.duration_s))


def _why_none(task: DesignProblem, goals: Goals) -> str:
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


def with_suspects(task: DesignProblem, design: Design) -> Design:
    """The design, with what it would show."""
    poses = imagined_dwells(design.elevations_deg, design.dwell_s, task.pace)
    hidden: tuple[str, ...] = ()
    if design.sweep is not None and task.sweeping is not None:
        poses = imagined_sweep(design.sweep, task.pace, task.sweeping.turning, task.seed)
        hidden = ONLY_DWELLS_SHOW
    return replace(design, suspects=tuple(suspects(poses, design.scatter_deg, hidden)))


def allowed_deg(task: DesignProblem, goals: Goals, scatter_deg: float) -> float:
    """RMS of an effect that may stay hidden.

    As large as the uncertainty wanted: more would not be covered. Where the rig may sweep, there is time for
    more: no more than the default plan too leaves hidden of a drift, its readings as uncertain as is wanted.

    `scatter_deg` is of readings, where no uncertainty is named.
    """
    wanted_deg = goals.expanded_deg
    if task.sweeping is None:
        return scatter_deg if wanted_deg is None else wanted_deg
    n = len(STANDARD_DEG)
    if wanted_deg is not None:
        wanted = Goals(expanded_deg=wanted_deg)
        leverages = leverage(list(STANDARD_DEG))
        scatter_deg = scatter_wanted_deg(wanted, task.type_b or NO_REFERENCE, n, leverages)
    return ITS_DRIFT * least_slow_deg(n, scatter_deg)


def could_show_enough(task: DesignProblem, goals: Goals, found: Sequence[Design]) -> Sequence[Design]:
    """Those that have poses enough for effects of time; all, where none has."""
    allowed = allowed_deg(task, goals, found[0].scatter_deg)
    able = [one for one in found if least_slow_deg(len(one.elevations_deg), one.scatter_deg) <= allowed]
    return able or found


def excess_of(task: DesignProblem, goals: Goals, first: Design) -> Callable[[Design], float]:
    """What tells how much more a design with its suspects hides than is allowed, as far as any shows it.

    That is the largest share of what is allowed; 1 and less is enough.

    `first` is the quickest design that reaches the goals.
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
        return sweep_designs.made(task, task.sweeping, replace(sweep, passes=passes, stretches=stretches))
    n, sweeps, at_ends = RICH
    order = layout(task.range_deg, n, sweeps, at_ends, np.random.default_rng([task.seed, *RICH[:2]]))
    return task.stated(order, dwell_s, math.nan, task.precision.scatter_deg(dwell_s))


BACK = 0.8
"""Of the way back, which ends at the last of its poses."""

EACH, STEP = 60, 1.1
"""Poses up to which each number is looked at by itself, and by how much the next ones differ: of 66 poses the
factor of Student's distribution is 0.1 % less."""


def limit_s(task: DesignProblem, goals: Goals, *, must_show: bool = True) -> float:
    """A time that no plan is under: the data where they say most, and what cannot be left out beside them.

    The poses stand at the two ends and nowhere else; they are as many as are soonest taken, and as could show
    an effect of time where effects are to be traced.

    Without `must_show`, as for a plan for a time, a plan may hide more than is allowed.
    """
    must_show = must_show and task.trace and not task.until and goals.expanded_deg is not None
    of_sweeps_s = math.inf if task.sweeping is None else _of_sweeps_s(task, goals, must_show=must_show)
    return min(_of_dwells_s(task, goals, must_show=must_show), of_sweeps_s)


def _of_dwells_s(task: DesignProblem, goals: Goals, *, must_show: bool) -> float:
    """To the nearer end, and through the range; there and back where effects are to be traced in any case."""
    pace, stands_s = task.pace, math.inf
    fewest, ways = (FEWEST_TRACED, 1.0 + BACK) if task.trace else (POSES[0], 1.0)
    if task.until:
        fewest, ways = FEWEST_UNTIL, 1.0
    for n in range(fewest, POSES[-1] + 1):
        if n * (SHORTEST_DWELL_S + pace.settle_s + pace.questions_s) > stands_s:
            break
        dwell_s = max(SHORTEST_DWELL_S, _at_the_ends_s(task, goals, n, task.precision))
        if not must_show or _shows(task, goals, n, dwell_s, task.precision):
            stands_s = min(stands_s, n * (dwell_s + pace.settle_s + pace.questions_s))
    ways_s = ways * pace.travel_s(task.range_deg[1] - task.range_deg[0])
    return pace.begin_s + _to_an_end_s(task) + ways_s + stands_s


def _of_sweeps_s(task: DesignProblem, goals: Goals, *, must_show: bool) -> float:
    """To the nearer end, settling, and data in all of the rest, in stretches as short as can be."""
    assert task.sweeping is not None  # noqa: S101 (asked by limit_s)
    turning, precision = task.sweeping.turning, task.sweeping.precision
    least_s, passes = math.inf, 1 if task.until else PASSES[0]
    for n in range(max(FEWEST_UNTIL, FEWEST_TRACED if task.trace and not task.until else 0), 4 * POSES[-1]):
        if n * SHORTEST_DWELL_S > least_s:
            break
        turned = Sweep(task.range_deg, passes, max(1, (n - 1) // passes - 1), 1.0)
        stretch_s = max(least_stretch_s(turned, turning), _at_the_ends_s(task, goals, n, precision))
        if not must_show or _shows(task, goals, n, stretch_s, precision):
            least_s = min(least_s, n * stretch_s)
    pace = task.pace
    first_s = _to_an_end_s(task) + max(pace.settle_s, FIRST_SETTLE_S)
    return pace.begin_s + first_s + passes * pace.settle_s + (passes + 1) * pace.pass_s + least_s


def _to_an_end_s(task: DesignProblem) -> float:
    """The move to the end that is nearer to the stage."""
    return min(task.pace.travel_s(abs(end_deg - task.pace.stands_deg)) for end_deg in task.range_deg)


def _at_the_ends_s(task: DesignProblem, goals: Goals, n: int, precision: Precision) -> float:
    """The shortest dwells with which so many poses reach the goals wherever they stand; infinite if none do.

    Of a line over m ± h no n poses have less variance than n at the ends in the best of shares (Hoel and
    Levine, 1964): 4/3 in the mean over the range, 1/h² of its slope, and at 0 1 within the range and (m/h)²
    beyond it, all over n. An odd number of poses does not come to that.
    """
    low, high = task.range_deg
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    leverages = BEST_OVER_RANGE / n, max(1.0, (middle / half) ** 2) / n, 1.0 / (n * half**2)
    wanted_deg = scatter_wanted_deg(goals, task.type_b or NO_REFERENCE, _as_good_as(n), leverages)
    return precision.dwell_s(wanted_deg) if wanted_deg > 0.0 else math.inf


def _as_good_as(n: int) -> int:
    """A number of poses whose scatter is known no worse: of few numbers, each of which takes a while."""
    return n if n <= EACH else math.ceil(EACH * STEP ** math.ceil(math.log(n / EACH) / math.log(STEP)))


def _shows(task: DesignProblem, goals: Goals, n: int, dwell_s: float, precision: Precision) -> bool:
    """Whether so many such poses could show effects of time of the size that is not to hide."""
    if math.isinf(dwell_s):
        return True
    rich_s = max(SHORTEST_DWELL_S, _at_the_ends_s(task, goals, RICH[0], precision))
    allowed = allowed_deg(task, goals, precision.scatter_deg(dwell_s))
    if least_slow_deg(RICH[0], precision.scatter_deg(rich_s)) > allowed:
        return True  # no plan shows it
    return least_slow_deg(n, precision.scatter_deg(dwell_s)) <= allowed
