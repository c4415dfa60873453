"""How a run is laid out: where it goes, in which order, when, and what else was written down at each pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calrig.plan import Plan
from calrig.simulator.bench import Bench
from calrig.simulator.config import SimulatorSettings

ACCELERATION_DPS2, HOMING_DPS = 80.0, 10.0
LIMITS_DEG = (-90.0, 90.0)
ON_THE_MOVE_S = 0.01
"""How long a reading takes that nothing stops for."""


class Timeline(NamedTuple):
    """When each pose's move begins, ends, and its dwell begins and ends, each (n,); targets (n,).

    `columns` (n,) each were written down beside it.
    """

    move_s: np.ndarray
    arrival_s: np.ndarray
    begin_s: np.ndarray
    end_s: np.ndarray
    target_deg: np.ndarray
    columns: Mapping[str, np.ndarray] = {}

    @property
    def duration_s(self) -> float:
        return float(self.end_s[-1])


@dataclass(frozen=True)
class Layout:
    """A run's poses before anything is measured.

    Attributes:
        target_deg: (n,) in the order measured; of a run on the move the turning points of its strokes.
        sweep: (n,) index of the sweep.
        wait_s: (n,) before each move.
        every_s: between the readings of a run on the move; None where each pose stands still.
        columns: (n,) each, what else was written down.
    """

    target_deg: np.ndarray
    sweep: np.ndarray
    settle_s: float = 1.0
    dwell_s: float = 2.0
    velocity_dps: float = 20.0
    wait_s: np.ndarray | None = None
    every_s: float | None = None
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def of(cls, plan: Plan) -> Layout:
        """A plan's poses, jittered by its own seed."""
        poses = plan.poses(LIMITS_DEG)
        targets = np.array([pose.target_deg for pose in poses])
        return cls(targets, np.array([pose.sweep for pose in poses]), plan.settle_s, plan.dwell_s)

    def carried_out(self, bench: Bench) -> Timeline:
        """The run's moves, made on a bench."""
        now_s = bench.mechanics.home(0.0, HOMING_DPS, ACCELERATION_DPS2).at_s
        if self.every_s is not None:
            return self._on_the_move(bench, now_s, self.every_s)
        wait_s = np.zeros(len(self.target_deg)) if self.wait_s is None else self.wait_s
        rows = []
        for target, waits_s in zip(self.target_deg.tolist(), wait_s.tolist(), strict=True):
            move_s = now_s + waits_s
            arrival_s = bench.mechanics.move(move_s, target, self.velocity_dps, ACCELERATION_DPS2).at_s
            begin_s = arrival_s + self.settle_s
            now_s = begin_s + self.dwell_s
            rows.append((move_s, arrival_s, begin_s, now_s))
        return Timeline(*np.array(rows).T, self.target_deg, self.columns)

    def _on_the_move(self, bench: Bench, now_s: float, every_s: float) -> Timeline:
        """Strokes from turning point to turning point, read while the stage turns at its velocity."""
        first, *others = self.target_deg.tolist()
        now_s = bench.mechanics.move(now_s, first, self.velocity_dps, ACCELERATION_DPS2).at_s
        ramp_s = self.velocity_dps / ACCELERATION_DPS2
        read_s = []
        for target in others:
            arrival_s = bench.mechanics.move(now_s, target, self.velocity_dps, ACCELERATION_DPS2).at_s
            read_s.append(np.arange(now_s + ramp_s, arrival_s - ramp_s, every_s))
            now_s = arrival_s
        at_s = np.concatenate(read_s)
        counted_deg = bench.mechanics.motor(at_s + 0.5 * ON_THE_MOVE_S).angle_deg
        return Timeline(at_s, at_s, at_s, at_s + ON_THE_MOVE_S, counted_deg, self.columns)


def timeline(laid_out: Layout | Plan) -> Timeline:
    """When what happens: known before anything is wrong with the rig."""
    layout = Layout.of(laid_out) if isinstance(laid_out, Plan) else laid_out
    return layout.carried_out(Bench(SimulatorSettings()))
