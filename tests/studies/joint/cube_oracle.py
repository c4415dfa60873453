"""The Cramér-Rao bound of a cube on a stage by numerical differentiation of that bench alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .cube import CubeBench, Seat, WholeUnit
from .oracle import slopes
from .rig import Stage

LINEAR, CUBIC = 12, 18
"""Parameters of a unit."""
DIAL_DEG = np.arange(-180.0, 180.0, 5.0)
FRAME = 3
"""Turning the unit against its seats changes nothing that is measured."""


@dataclass(frozen=True)
class Bound:
    """Root mean squares over the axes, and over the dial; infinite where the poses do not tell."""

    bias_mg: float
    scale_ppm: float
    skew_mrad: float
    map_deg: float


def bound(bench: CubeBench, *, linear: bool) -> Bound:
    """What an efficient solution is wrong by."""
    start = _numbers(bench)
    free = np.array([k for k in range(len(start)) if k < LINEAR or k >= CUBIC or not linear])
    columns = slopes(lambda x: _felt(bench, x), start)[:, free] / math.radians(bench.noise_deg)
    scale = np.linalg.norm(columns, axis=0)
    _, size, turn = np.linalg.svd(columns / scale, full_matrices=False)
    told = size > 1e-6 * size[0]
    if (~told).sum() > FRAME:
        return Bound(math.inf, math.inf, math.inf, math.inf)

    def stds(function) -> np.ndarray:
        parts = (slopes(function, start)[:, free] / scale) @ turn[told].T / size[told]
        return np.sqrt((parts**2).sum(axis=1))

    def rms(of: np.ndarray) -> float:
        return float(np.sqrt(np.mean(of**2)))

    figures = stds(lambda x: sensor_figures(_bench(bench, x).unit))
    on_map = stds(lambda x: map_error_deg(_bench(bench, x)))
    return Bound(rms(figures[:3]), rms(figures[3:6]), rms(figures[6:9]), rms(on_map))


def sensor_figures(unit: WholeUnit) -> np.ndarray:
    """(9,) offsets in mg, scales in ppm, angles between axes in mrad; each in the sensor's own frame."""
    matrix = unit.in_sensor_frame()
    return np.concatenate([unit.bias_mg, figures_of(matrix)])


def figures_of(matrix: np.ndarray) -> np.ndarray:
    """(6,) of an upper triangular matrix: its diagonal in ppm, what is beside it in mrad."""
    return np.concatenate([1e6 * np.diag(matrix), 1e3 * matrix[[0, 0, 1], [1, 2, 2]]])


def map_error_deg(bench: CubeBench) -> np.ndarray:
    """(72,) the stage's error over its turn, less its mean."""
    error = bench.stage.table_deg(DIAL_DEG, np.zeros(len(DIAL_DEG))) - DIAL_DEG
    return error - error.mean()


def _felt(bench: CubeBench, numbers: np.ndarray) -> np.ndarray:
    changed = _bench(bench, numbers)
    return np.concatenate([changed.felt_g(seat).ravel() for seat in changed.seats])


def _numbers(bench: CubeBench) -> np.ndarray:
    """The unit, each seat as a rotation vector, the dip, each wave as its cosine and sine."""
    unit = bench.unit
    own = [*unit.bias_mg, *unit.gain_pct, *unit.cross_deg, *unit.quadratic_mg, *unit.cubic_mg]
    waves = [
        part
        for _, size, phase in bench.stage.waves
        for part in (size * math.cos(math.radians(phase)), size * math.sin(math.radians(phase)))
    ]
    return np.array([*own, *np.zeros(3 * len(bench.seats)), bench.dip_deg, *waves], dtype=np.float64)


def _bench(bench: CubeBench, numbers: np.ndarray) -> CubeBench:
    own, rest = numbers[:CUBIC], numbers[CUBIC:]
    unit = replace(
        bench.unit,
        bias_mg=tuple(own[0:3]),
        gain_pct=tuple(own[3:6]),
        cross_deg=tuple(own[6:12]),
        quadratic_mg=tuple(own[12:15]),
        cubic_mg=tuple(own[15:18]),
    )
    n = 3 * len(bench.seats)
    seats = tuple(
        _TurnedSeat(seat.face, seat.angle_deg, seat.off_deg, tuple(turn))
        for seat, turn in zip(bench.seats, rest[:n].reshape(-1, 3), strict=True)
    )
    waves = tuple(
        (order, math.hypot(c, s), math.degrees(math.atan2(s, c)))
        for (order, _, _), (c, s) in zip(bench.stage.waves, rest[n + 1 :].reshape(-1, 2), strict=True)
    )
    return replace(
        bench, unit=unit, seats=seats, dip_deg=float(rest[n]), stage=Stage(waves, bench.stage.gap_deg)
    )


@dataclass(frozen=True)
class _TurnedSeat(Seat):
    """A seat turned further by a small rotation vector, degrees."""

    more_deg: tuple[float, ...] = (0.0, 0.0, 0.0)

    def rotation(self):
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(self.more_deg, degrees=True) * super().rotation()
