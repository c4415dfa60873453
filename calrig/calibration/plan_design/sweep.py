"""Designs that turn without stopping: stretches for poses, a dwell at either end of each pass."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from calrig.calibration.plan_design.rig_figures import Pace, Precision, Turning
from calrig.plan import FIRST_SETTLE_S, LONGEST_STRETCH_DEG, Plan, PlannedPose

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
        return self.stretch_s - _run_up_deg(self.velocity_dps, turning) / self.velocity_dps

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


def _run_up_deg(velocity_dps: float, turning: Turning) -> float:
    return velocity_dps**2 / (2.0 * turning.acceleration_dps2) + RUN_UP_S * velocity_dps
