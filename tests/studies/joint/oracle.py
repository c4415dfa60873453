"""The Cramér-Rao bound of a bench by numerical differentiation of the bench itself: no model of calrig's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .rig import Bench, Stage, Unit, Visit, about_x

STEP = 1e-4
"""Of a parameter in its own unit (mg, %, °), small beside what bends the vector."""
GRID_DEG = np.linspace(-60.0, 60.0, 121)
LINEAR, CUBIC = 5, 9
"""Parameters of a unit: offsets, gains, skew; and quadratic and cubic terms."""


def bound_deg(bench: Bench, *, linear: bool = False) -> float:
    """RMS over ±60° of what an efficient calibration of unit 0 is wrong by, its mean removed, degrees.

    Infinite where the poses do not tell.
    """
    wide = LINEAR if linear else CUBIC
    start = _numbers(bench)
    free = [k for k in range(len(start)) if k < wide or k >= CUBIC]

    def response(numbers: np.ndarray) -> np.ndarray:
        changed = _bench(bench, numbers)
        return np.concatenate([changed.felt_g(visit).ravel() for visit in changed.visits])

    def elevation(numbers: np.ndarray) -> np.ndarray:
        return angle_deg(_bench(bench, numbers).units[0], GRID_DEG)

    columns = slopes(response, start)[:, free]
    slope = (angle_deg(bench.units[0], GRID_DEG + STEP) - angle_deg(bench.units[0], GRID_DEG - STEP)) / (
        2 * STEP
    )
    wrong = -slopes(elevation, start)[:, free] / slope[:, None]
    wrong -= wrong.mean(axis=0)
    scale = np.linalg.norm(columns, axis=0)
    _, size, turn = np.linalg.svd(columns / scale, full_matrices=False)
    parts = (wrong / scale) @ turn.T / size
    if size[-1] < 1e-9 * size[0] and np.abs(parts[:, -1]).max() > 1e3:
        return math.inf
    return float(np.sqrt(np.mean((parts**2).sum(axis=1)))) * math.radians(bench.noise_deg)


def calibrated_error_deg(bench: Bench, unit: int, die_c: float, apply) -> np.ndarray:
    """(121,) what `apply` makes of the unit's angle over ±60°, less the truth and its own mean."""
    error = apply(angle_deg(bench.units[unit], GRID_DEG, die_c)) - GRID_DEG
    return error - error.mean()


def angle_deg(unit: Unit, elevation_deg: np.ndarray, die_c: float = 25.0) -> np.ndarray:
    force = about_x(elevation_deg) @ np.array([0.0, 0.0, 1.0])
    felt = unit.felt_g(force, np.full(len(elevation_deg), die_c))
    return np.degrees(np.arctan2(felt[:, 1], felt[:, 2]))


def _numbers(bench: Bench) -> np.ndarray:
    """Unit 0, clamps, and every wave as its amplitude and phase."""
    unit = bench.units[0]
    own = [*unit.bias_mg, *unit.gain_pct, unit.skew_deg, *unit.quadratic_mg, *unit.cubic_mg]
    waves = [number for _, amplitude, phase in bench.stage.waves for number in (amplitude, phase)]
    return np.array([*own, *(visit.clamp_deg for visit in bench.visits), *waves])


def _bench(bench: Bench, numbers: np.ndarray) -> Bench:
    own, n = numbers[:CUBIC], len(bench.visits)
    unit = Unit(tuple(own[0:2]), tuple(own[2:4]), float(own[4]), tuple(own[5:7]), tuple(own[7:9]))
    clamps, waves = numbers[CUBIC : CUBIC + n], numbers[CUBIC + n :].reshape(-1, 2)
    visits: list[Visit] = [replace(v, clamp_deg=float(c)) for v, c in zip(bench.visits, clamps, strict=True)]
    stage = Stage(
        tuple((order, a, p) for (order, _, _), (a, p) in zip(bench.stage.waves, waves, strict=True)),
        bench.stage.gap_deg,
    )
    return Bench((unit,), stage, tuple(visits), bench.noise_deg)


def slopes(function, start: np.ndarray) -> np.ndarray:
    """(m, p) derivatives of a function (p,) → (m,), by differences."""
    steps = STEP * np.eye(len(start))
    return np.stack([(function(start + s) - function(start - s)) / (2.0 * STEP) for s in steps], axis=1)
