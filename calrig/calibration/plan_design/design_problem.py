"""Define the problem that a design solves: goals, reference, precision and pace; and the design itself."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

from calrig.calibration.correlated_errors import expected_widening
from calrig.calibration.plan_design.layout import Pace, Precision, Sweep, Turning, leverage
from calrig.calibration.plan_design.smallest_effects import Suspect
from calrig.calibration.uncertainty.coverage import coverage_factor
from calrig.model.result import Reference


@dataclass(frozen=True, slots=True)
class Goals:
    """Standard errors and expanded uncertainty that are wanted; None where it does not matter."""

    expanded_deg: float | None = None
    bias_std_deg: float | None = None
    scale_std: float | None = None

    def reached_by(
        self, expanded_deg: float | None, bias_std_deg: float | None, scale_std: float | None
    ) -> bool:
        """Whether what is stated is all that is wanted; what is not known reaches nothing."""
        pairs = (
            (expanded_deg, self.expanded_deg),
            (bias_std_deg, self.bias_std_deg),
            (scale_std, self.scale_std),
        )
        return all(wanted is None or (stated is not None and stated <= wanted) for stated, wanted in pairs)


@dataclass(frozen=True, slots=True)
class TypeB:
    """What the reference makes of an elevation: standard uncertainty, degrees, and its distribution.

    `reference` is of a stage's certificate; a stage's map has its own covariance. Of kind `setting`,
    `std_deg` is of one setting: of a line through many, ask `of_line`.
    """

    std_deg: float
    reference: Reference | None

    @property
    def distribution(self) -> str:
        """Of the error of an elevation."""
        if self.reference is None or self._is_of_settings:
            return "normal"
        return self.reference.distribution

    @property
    def _is_of_settings(self) -> bool:
        return self.reference is not None and self.reference.kind == "setting"

    def of_line(self, over_range: float) -> Self:
        """What it makes of an elevation by a line whose mean variance over the range is this for scatter 1.

        An independent error of each setting enters as a scatter does (`uncertainty.reference_part`); any
        other is the same however many poses there are.
        """
        return replace(self, std_deg=self.std_deg * math.sqrt(over_range)) if self._is_of_settings else self

    def expanded_deg(self, type_a_deg: float, freedom: float) -> float:
        """The expanded uncertainty beside one of type A, as a result states it."""
        distribution = "rectangular" if self.distribution == "rectangular" else "normal"
        k = coverage_factor(type_a_deg, freedom, self.std_deg, distribution)
        return k * math.hypot(type_a_deg, self.std_deg)

    @property
    def least_deg(self) -> float:
        """The expanded uncertainty that no number of poses gets below; of settings a mean has none."""
        if not self.std_deg or self._is_of_settings:
            return 0.0
        return self.expanded_deg(1e-12 * max(self.std_deg, 1e-6), 1e9)

    def why_beyond(self, goals: Goals) -> str | None:
        """Why no number of poses reaches the expanded uncertainty, and what would; None where some may."""
        if goals.expanded_deg is None or goals.expanded_deg > self.least_deg:
            return None
        return (
            f"an expanded uncertainty of {goals.expanded_deg:g}° cannot be reached: the stage's uncertainty "
            f"alone makes it {self.least_deg:.3g}°, however many poses there are. Ask for more, or improve "
            "the reference: a stage certificate with a smaller uncertainty, or a stage map, which Solve "
            "finds from runs of one unit clamped at 0°, 120° and 240°"
        )


@lru_cache(maxsize=4096)
def _type_a_deg(type_b: TypeB, expanded_deg: float, freedom: float) -> float:
    """The largest standard uncertainty of type A beside a reference; 0 where none is small enough.

    Layouts ask for it again and again: a rectangular distribution's factor takes a millisecond.
    """
    from scipy.optimize import brentq

    least_deg = 1e-6 * expanded_deg
    if type_b.expanded_deg(least_deg, freedom) >= expanded_deg:
        return 0.0
    found = brentq(
        lambda type_a_deg: type_b.expanded_deg(type_a_deg, freedom) - expanded_deg,
        least_deg,
        expanded_deg,
        xtol=1e-7 * expanded_deg,
    )
    return float(found) - 2e-7 * expanded_deg  # below the root by more than its tolerance


NO_REFERENCE = TypeB(0.0, None)


def scatter_wanted_deg(
    goals: Goals, type_b: TypeB, n_poses: int, leverages: tuple[float, float, float]
) -> float:
    """The largest scatter of a reading with which so many poses reach all goals; 0 where none does.

    `type_b` is the reference's part, `leverages` are of the layout, for scatter 1 (`layout.leverage`). The
    line takes two degrees of freedom.
    """
    reading, of_bias, of_scale = stated_for_scatter_1(n_poses, leverages)
    allowed = [math.inf]
    if goals.expanded_deg is not None:
        type_a_deg = _type_a_deg(type_b.of_line(leverages[0]), goals.expanded_deg, n_poses - 2.0)
        allowed.append(type_a_deg / reading)
    if goals.bias_std_deg is not None:
        allowed.append(goals.bias_std_deg / of_bias)
    if goals.scale_std is not None:
        allowed.append(goals.scale_std / of_scale)
    return min(allowed)


def stated_for_scatter_1(n_poses: int, leverages: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return standard uncertainties that a result states where readings have white noise of 1.

    Type A of an elevation, standard errors of bias and scale: they allow for correlation, so that they are
    larger than those of ordinary least squares (`expected_widening`).
    """
    (over_range, bias, scale), (scatter, of_bias, of_scale) = leverages, expected_widening(n_poses)
    reading = math.sqrt(scatter**2 + of_bias**2 * over_range)
    return reading, of_bias * math.sqrt(bias), of_scale * math.sqrt(scale)


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
class DesignProblem:
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
        leverages = leverage(order)
        reading, bias, scale = stated_for_scatter_1(len(order), leverages)
        stated_deg = cautioned * scatter_deg
        expanded_deg: float | None = None
        if self.type_b is not None:
            type_b = self.type_b.of_line(leverages[0])
            expanded_deg = type_b.expanded_deg(stated_deg * reading, len(order) - 2.0)
        return Design(
            elevations_deg=tuple(order),
            dwell_s=dwell_s,
            duration_s=duration_s,
            expanded_deg=expanded_deg,
            bias_std_deg=stated_deg * bias,
            scale_std=stated_deg * scale,
            scatter_deg=scatter_deg,
            sweep=sweep,
        )

    def restated(self, design: Design, ratio: float, cautioned: float) -> Design:
        """The design where readings happen to scatter `ratio` times as much; `cautioned` as in `stated`."""
        return self.stated(
            list(design.elevations_deg),
            design.dwell_s,
            design.duration_s,
            design.scatter_deg * ratio,
            cautioned,
            design.sweep,
        )


def rounded_up_s(dwell_s: float) -> float:
    """The next time that a plan names."""
    return round(DWELL_STEP_S * math.ceil(dwell_s / DWELL_STEP_S - 1e-9), 3)


def rounded_down_s(dwell_s: float) -> float:
    """The one before."""
    return round(DWELL_STEP_S * math.floor(dwell_s / DWELL_STEP_S + 1e-9), 3)
