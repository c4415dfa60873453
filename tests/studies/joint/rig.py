"""A stage with a map of its own, units clamped on it at several angles: nothing here knows the joint model.

Tables and clamps turn a vector by matrices, the simulator's accelerometer feels it. Noise is drawn for the
components of each pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from calrig.calibration.poses import Pose
from calrig.calibration.separation.pose_table import MountedPoses
from calrig.simulator.config import ImuOptions
from calrig.simulator.imu import Imu, Surroundings

REFERENCE_C = 25.0


@dataclass(frozen=True)
class Unit:
    """Errors of an accelerometer's y and z axis, as the simulator has them."""

    bias_mg: tuple[float, float] = (0.0, 0.0)
    gain_pct: tuple[float, float] = (0.0, 0.0)
    skew_deg: float = 0.0
    quadratic_mg: tuple[float, float] = (0.0, 0.0)
    cubic_mg: tuple[float, float] = (0.0, 0.0)
    mg_per_c: tuple[float, float] = (0.0, 0.0)
    in_case_deg: float = 0.0
    """By how much the sensor is turned about x in its case: the level."""

    def felt_g(self, force_g: np.ndarray, die_c: np.ndarray) -> np.ndarray:
        """(n, 3) what it makes of a specific force (n, 3)."""
        options = ImuOptions(
            accel_bias_mg=(0.0, *self.bias_mg),
            accel_gain_error_pct=(0.0, *self.gain_pct),
            accel_cross_axis_deg={"yz": self.skew_deg},
            accel_quadratic_mg_per_g2=(0.0, *self.quadratic_mg),
            accel_cubic_mg_per_g3=(0.0, *self.cubic_mg),
            accel_bias_mg_per_c=(0.0, *self.mg_per_c),
            reference_c=REFERENCE_C,
        )
        return Imu(options).accel_g(force_g, Surroundings(die_c, die_c, np.zeros(len(die_c))))


@dataclass(frozen=True)
class Stage:
    """A map of (order, amplitude, phase), degrees, and a gap in the gear: the table lags by half of it."""

    waves: tuple[tuple[float, float, float], ...] = ()
    gap_deg: float = 0.0

    def table_deg(self, dial_deg: np.ndarray, approach: np.ndarray) -> np.ndarray:
        """(n,) where the table stands."""
        error = -0.5 * self.gap_deg * approach
        for order, amplitude, phase in self.waves:
            error = error + amplitude * np.sin(np.radians(order * dial_deg + phase))
        return dial_deg + error


@dataclass(frozen=True)
class Visit:
    """One clamping of a unit: the angle of its seat in truth, and the dial's angles that it was taken to.

    `reversed` is with the same face, turned by 180° about the vertical; `askew_deg` by so much more.
    """

    unit: int
    clamp_deg: float
    dial_deg: np.ndarray
    approach: np.ndarray
    die_c: np.ndarray
    nominal_deg: float = 0.0
    name: str = "a"
    reversed: bool = False
    askew_deg: float = 0.0


@dataclass(frozen=True)
class Bench:
    """Units, a stage, and what was done."""

    units: tuple[Unit, ...]
    stage: Stage
    visits: tuple[Visit, ...]
    noise_deg: float = 0.03
    correlation: float = 0.0
    """Of the noise from one pose to the next."""
    base_deg: float = 0.0
    """By how much the base is out of level about the stage's axis."""
    axis_out_deg: float = 0.0
    """By how much the axis itself is."""

    def felt_g(self, visit: Visit) -> np.ndarray:
        """(n, 2) a_y and a_z without noise."""
        table = self.stage.table_deg(visit.dial_deg, visit.approach)
        unit, n = self.units[visit.unit], len(table)
        on_seat = about_x(np.full(n, visit.clamp_deg)) @ about_x(table) @ about_x(np.full(n, self.base_deg))
        in_case = about_z(180.0 * visit.reversed + visit.askew_deg) @ on_seat
        out = math.radians(self.axis_out_deg)
        force = (
            about_x(np.full(n, unit.in_case_deg)) @ in_case @ np.array([math.sin(out), 0.0, math.cos(out)])
        )
        return unit.felt_g(force, visit.die_c)[:, 1:]

    def measured(self, rng: np.random.Generator, *, accel: bool = True) -> list[MountedPoses]:
        """The poses of each clamping."""
        found = []
        for visit in self.visits:
            vector = self.felt_g(visit) + self._noise_g(rng, len(visit.dial_deg))
            poses = poses_of(visit, vector, accel=accel)
            axis = "-x" if visit.reversed else "x"
            found.append(MountedPoses(f"U{visit.unit}", visit.name, visit.nominal_deg, "rig", poses, axis))
        return found

    def _noise_g(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """(n, 2), as it has become after a long time."""
        drawn = rng.normal(0.0, math.radians(self.noise_deg), (n, 2))
        own = math.sqrt(1.0 - self.correlation**2)
        for before, now in pairwise(drawn):
            now[:] = self.correlation * before + own * now
        return drawn


def about_x(angle_deg: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotations by which (0, 0, 1) goes to (0, sin, cos)."""
    s, c = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
    one, nil = np.ones_like(s), np.zeros_like(s)
    return np.stack([one, nil, nil, nil, c, s, nil, -s, c], axis=1).reshape(-1, 3, 3)


def about_z(angle_deg: float) -> np.ndarray:
    """(3, 3) a rotation about the vertical of the case."""
    s, c = math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def poses_of(visit: Visit, vector_g: np.ndarray, *, accel: bool = True) -> list[Pose]:
    """Poses with these vectors (n, 2); the reading is their angle on the turn that the dial is on."""
    angle = np.degrees(np.arctan2(vector_g[:, 0], vector_g[:, 1]))
    warm = np.ptp(visit.die_c) > 0.0
    return [
        Pose(
            target_deg=float(visit.dial_deg[k]),
            reading_deg=float(angle[k]),
            approach=int(visit.approach[k]),
            time_s=10.0 * k,
            temperature_c=float(visit.die_c[k]) if warm else None,
            stage_deg=float(visit.dial_deg[k]),
            accel_y_g=float(vector_g[k, 0]) if accel else None,
            accel_z_g=float(vector_g[k, 1]) if accel else None,
        )
        for k in range(len(angle))
    ]


ISSUE_UNIT = Unit((50.0, 80.0), (3.0, -2.0), 0.6, (5.0, -5.0), (-5.0, 5.0))
"""Offsets 50/80 mg, gains 3 %, skew, quadratic and cubic terms of 0.5 %."""


def drawn_unit(rng: np.random.Generator, *, cubic: bool = True, drift: bool = False) -> Unit:
    """A unit of the size of the issue's."""
    curved = 5.0 if cubic else 0.0
    return Unit(
        tuple(rng.normal(0.0, (50.0, 80.0))),
        tuple(rng.normal(0.0, 2.0, 2)),
        float(rng.normal(0.0, 0.5)),
        tuple(rng.normal(0.0, curved, 2)),
        tuple(rng.normal(0.0, curved, 2)),
        tuple(rng.normal(0.0, 0.3, 2)) if drift else (0.0, 0.0),
    )


def drawn_stage(
    rng: np.random.Generator, highest: int = 6, rms_deg: float = 0.29, gap_deg: float = 0.0
) -> Stage:
    """Orders 1 to `highest`, of amplitudes at random, together of this RMS."""
    size = np.abs(rng.normal(size=highest))
    size *= rms_deg * math.sqrt(2.0) / np.linalg.norm(size)
    phases = rng.uniform(0.0, 360.0, highest)
    return Stage(tuple(zip(range(1, highest + 1), size.tolist(), phases.tolist(), strict=True)), gap_deg)


@dataclass(frozen=True)
class Design:
    """How a bench is used: clamping angles, and an arc of the dial for `n` poses a mount."""

    mounts_deg: tuple[float, ...]
    arc_deg: tuple[float, float] = (-60.0, 60.0)
    n: int = 72
    turn: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "turn", self.arc_deg[1] - self.arc_deg[0] >= 360.0)

    def visits(self, rng: np.random.Generator | None = None, *, warm_c: float = 0.0) -> tuple[Visit, ...]:
        """Up and down in two sweeps; mounts a few degrees from where they should be, where drawn."""
        up = np.linspace(*self.arc_deg, self.n // 2, endpoint=not self.turn)
        half_step = 0.5 * (up[1] - up[0])
        dial = np.concatenate([up, (up + half_step)[::-1]])
        approach = np.repeat([1.0, -1.0], [len(up), len(dial) - len(up)])
        found = []
        for k, nominal in enumerate(self.mounts_deg):
            off = 0.0 if rng is None else float(rng.normal(0.0, 0.8))
            share = (np.arange(len(dial)) / len(dial) + k) / len(self.mounts_deg)
            die = REFERENCE_C + warm_c * (1.0 - np.exp(-3.0 * share))
            found.append(Visit(0, nominal + off, dial, approach, die, nominal, f"m{k}"))
        return tuple(found)


def repeated(visits: Sequence[Visit], unit: int) -> tuple[Visit, ...]:
    """The same clampings of another unit."""
    return tuple(replace(visit, unit=unit, name=f"{visit.name}-{unit}") for visit in visits)
