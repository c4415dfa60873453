"""Lay poses out: dwells or continuous sweeps, in which order, with which precision and in which time."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calrig.calibration.uncertainty.budget import mean_over_range
from calrig.estimation.angles import FloatArray
from calrig.model.plan import FIRST_SETTLE_S, LONGEST_STRETCH_DEG, Plan, PlannedPose

DATA_SHEET_WHITE = math.degrees(400e-6 / math.sqrt(2.0))
"""°·√s of an elevation by an MPU-6050: 400 µg/√Hz, one-sided (PS-MPU-6000A rev. 3.4, section 6.2)."""

BEYOND_CHANCE = 0.05
"""Level of the test that readings scatter by more than their noise."""


@dataclass(frozen=True, slots=True)
class Precision:
    """Scatter of a reading about the line, by how long it dwells.

    Attributes:
        white_deg_rts: white noise: the mean over T seconds has this over √T, degrees.
        pose_deg: what scatters from pose to pose however long each is.
        said: where both are from, in words.
    """

    white_deg_rts: float
    pose_deg: float
    said: str

    def scatter_deg(self, dwell_s: float) -> float:
        """Standard deviation of a reading that dwells so long."""
        return math.hypot(self.white_deg_rts / math.sqrt(dwell_s), self.pose_deg)

    def dwell_s(self, scatter_deg: float) -> float:
        """How long to dwell for such a standard deviation; infinite where no dwell is long enough."""
        left = scatter_deg**2 - self.pose_deg**2
        return self.white_deg_rts**2 / left if left > 0.0 else math.inf


def precision_of_run(
    run_id: str, dwell_s: float, stderr_deg: float, scatter_deg: float, freedom: int
) -> Precision:
    """As an earlier run had it: within its dwells, and what its residuals scatter beyond that.

    Beyond it only where a χ² test says that there is more than chance makes of the noise: the residuals of 52
    poses are 10 % off by themselves, and a scatter that no dwell averages out is paid for with half the time
    again.

    Args:
        run_id: for the words.
        dwell_s: of its poses.
        stderr_deg: pooled standard error of a reading, from within the dwells.
        scatter_deg: standard deviation of the residuals, with everything accepted taken out.
        freedom: degrees of freedom of that.
    """
    from scipy.special import chdtri

    said = f"noise of a {dwell_s:g} s reading: {stderr_deg:.2g}°"
    if freedom * scatter_deg**2 <= float(chdtri(freedom, BEYOND_CHANCE)) * stderr_deg**2:
        return Precision(stderr_deg * math.sqrt(dwell_s), 0.0, f"{said}, from run {run_id}")
    pose_deg = math.sqrt(scatter_deg**2 - stderr_deg**2)
    said += f"; further scatter between poses: {pose_deg:.2g}°, from run {run_id}"
    return Precision(stderr_deg * math.sqrt(dwell_s), pose_deg, said)


NOT_MEASURED = Precision(
    DATA_SHEET_WHITE,
    0.0,
    "no completed run on this rig yet: the noise of an MPU-6050's data sheet is assumed",
)


@dataclass(frozen=True, slots=True)
class Turning:
    """What a stage turns at without stopping: at most so fast, and how soon it has come up to that."""

    velocity_dps: float
    acceleration_dps2: float


@dataclass(frozen=True, slots=True)
class Pace:
    """What a rig takes for each thing that a plan asks of it.

    Attributes:
        travel_s: time of a move of so many degrees.
        settle_s: after each move.
        questions_s: communication time at each pose, with the stage and the board.
        pass_s: communication time at each dwell of a sweep, its segments included.
        begin_s: before the first move.
        stands_deg: elevation from which the first move begins.
    """

    travel_s: Callable[[float], float]
    settle_s: float
    questions_s: float
    begin_s: float
    stands_deg: float = 0.0
    pass_s: float = 0.0


CLUSTER = 0.1
"""Share of the range within which poses at an end stand: each needs a move of its own before it."""
DECIMALS = 2


def layout(
    range_deg: tuple[float, float], n_poses: int, sweeps: int, at_ends: float, rng: np.random.Generator
) -> list[float]:
    """Elevations in the order of visiting.

    Places spread evenly but for a share that stands near the ends, where they say most of the scale; each
    is drawn within its own interval, so that no period hides in a grid. Every sweep visits places of its own,
    drawn at random, upward and downward in turn: the way stays short, and moves are of all lengths, in both
    senses at neighbouring places.

    Args:
        range_deg: lowest and highest elevation; both are visited.
        n_poses: how many, at least 2 a sweep.
        sweeps: how often the range is gone through.
        at_ends: share of the poses near the ends, 0 to 1.
        rng: draws places and sweeps.
    """
    low, high = range_deg
    within = rng.uniform(0.0, 1.0, n_poses)
    within[0], within[-1] = 0.0, 1.0
    places = _placed((np.arange(n_poses) + within) / n_poses, at_ends)
    elevations = np.round(low + (high - low) * places, DECIMALS)
    of_sweep = rng.permutation(np.arange(n_poses) % sweeps)
    of_sweep[0] = of_sweep[-1] = 0  # the ends first: a run that is cut short has the line
    order: list[float] = []
    for sweep in range(sweeps):
        own = np.sort(elevations[of_sweep == sweep])
        order += (own if sweep % 2 == 0 else own[::-1]).tolist()
    return order


def _placed(share: FloatArray, at_ends: float) -> FloatArray:
    """(n,) place in the range, 0 to 1, of a share of the poses: quantiles of ends and middle mixed."""
    inverse = np.linspace(0.0, 1.0, 1001)
    near_an_end = 0.5 * (np.clip(inverse / CLUSTER, 0, 1) + np.clip((inverse - 1.0) / CLUSTER + 1.0, 0, 1))
    below = at_ends * near_an_end + (1.0 - at_ends) * inverse
    return np.asarray(np.interp(share, below + 1e-9 * inverse, inverse), dtype=np.float64)


def way_s(elevations_deg: list[float], pace: Pace) -> float:
    """Time of all moves, from the first pose on."""
    return sum(pace.travel_s(abs(after - before)) for before, after in pairwise(elevations_deg))


BEST_OVER_RANGE = 4.0 / 3.0
"""Of n poses at the two ends, times n: no layout has less variance in the mean over the range."""


def leverage(elevations_deg: list[float]) -> tuple[float, float, float]:
    """Of a line through poses of scatter 1: variance of elevation (mean over the range), bias, scale."""
    theta = np.array(elevations_deg)
    design = np.column_stack([np.ones(len(theta)), theta])
    covariance = np.linalg.inv(design.T @ design)
    return mean_over_range(covariance, theta), float(covariance[0, 0]), float(covariance[1, 1])


PASSES = (2, 3, 4, 6, 8)
STRETCHES = (*range(6, 31), 34, 38, 44, 50, 60, 80)
"""Of a pass."""
RUN_UP_S = 0.25
"""After the stage has come up to its velocity and before it slows down: of no stretch."""
KEPT = 0.6
"""Of the first and the last stretch of a pass at least, beside the run-up."""
JITTER = 0.125
"""Of a stretch, by which its ends are shifted: no period hides in a grid."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """Slow turns through a range.

    Attributes:
        ends_deg: of the range it turns through; it begins at the first.
        passes: how often it turns through the range.
        stretches: of a pass, of one length but for the jitter.
        stretch_s: how long each takes, and the dwells too.
    """

    ends_deg: tuple[float, float]
    passes: int
    stretches: int
    stretch_s: float

    @property
    def way_deg(self) -> float:
        """Of a pass."""
        return abs(self.ends_deg[1] - self.ends_deg[0])

    @property
    def step_deg(self) -> float:
        """Of a stretch."""
        return self.way_deg / self.stretches

    @property
    def velocity_dps(self) -> float:
        """At which it turns, rounded down."""
        return round(self.step_deg / self.stretch_s - 0.5e-6, 6)

    def plan(self, seed: int | None = None) -> Plan:
        """What a run of it takes; jittered where there is a seed."""
        first, other = self.ends_deg
        return Plan(
            kind="sweep",
            start_deg=first,
            stop_deg=other,
            step_deg=math.ceil(1e4 * self.step_deg) / 1e4,
            sweeps=self.passes,
            velocity_dps=self.velocity_dps,
            dwell_s=self.stretch_s,
            jitter_deg=0.0 if seed is None else round(JITTER * self.step_deg, 4),
            seed=seed or 0,
        )

    def poses(self, seed: int | None = None) -> list[PlannedPose]:
        """In the order measured; a stretch's target is its middle."""
        return self.plan(seed).poses((min(self.ends_deg), max(self.ends_deg)))

    def elevations_deg(self) -> list[float]:
        """Of the poses, without jitter."""
        return [pose.target_deg for pose in self.poses()]

    def __len__(self) -> int:
        return 1 + self.passes * (self.stretches + 1)

    def outer_s(self, turning: Turning) -> float:
        """How long the first and the last stretch of a pass are, less what the run-up takes."""
        run_up_deg = self.velocity_dps**2 / (2.0 * turning.acceleration_dps2) + RUN_UP_S * self.velocity_dps
        return self.stretch_s - run_up_deg / self.velocity_dps

    def times_s(self, pace: Pace, turning: Turning) -> list[float]:
        """Of each pose the middle, from the first dwell's beginning on."""
        found, now_s = [0.5 * self.stretch_s], self.stretch_s
        for _ in range(self.passes):
            turned_s = self.way_deg / self.velocity_dps
            rise_s = self.velocity_dps / turning.acceleration_dps2
            found += [
                now_s + 0.5 * rise_s + (k + 0.5) / self.stretches * turned_s for k in range(self.stretches)
            ]
            now_s += turned_s + rise_s + pace.settle_s + pace.pass_s + self.stretch_s
            found.append(now_s - 0.5 * self.stretch_s)
        return found

    def duration_s(self, pace: Pace, turning: Turning) -> float:
        """From the beginning of the run to its end."""
        first_s = pace.travel_s(abs(self.ends_deg[0] - pace.stands_deg))
        stands_s = max(pace.settle_s, FIRST_SETTLE_S) + pace.pass_s
        return pace.begin_s + first_s + stands_s + self.times_s(pace, turning)[-1] + 0.5 * self.stretch_s

    def scatter_deg(self, precision: Precision, turning: Turning) -> float:
        """Root mean square of the standard deviations of its poses."""
        n, outer = len(self), 2 * self.passes
        whole, short = precision.scatter_deg(self.stretch_s), precision.scatter_deg(self.outer_s(turning))
        return math.sqrt(((n - outer) * whole**2 + outer * short**2) / n)


def sweeps(ends_deg: tuple[float, float], fewest_poses: int = 0) -> Iterator[Sweep]:
    """Every sweep that is tried, its stretches still of one second."""
    for passes in PASSES:
        for stretches in STRETCHES:
            made = Sweep(ends_deg, passes, stretches, 1.0)
            if made.step_deg <= LONGEST_STRETCH_DEG and len(made) >= fewest_poses:
                yield made


def least_stretch_s(sweep: Sweep, turning: Turning) -> float:
    """The shortest stretches: no faster than the stage turns, and enough left of the outer ones.

    Of those the run-up takes v²/(2a) + `RUN_UP_S`·v with v = step/T: T²·(1 − `KEPT`) is no less than
    step/(2a) + `RUN_UP_S`·T.
    """
    half = 0.5 * RUN_UP_S / (1.0 - KEPT)
    root = math.sqrt(half**2 + sweep.step_deg / (2.0 * turning.acceleration_dps2 * (1.0 - KEPT)))
    return max(half + root, sweep.step_deg / turning.velocity_dps)
