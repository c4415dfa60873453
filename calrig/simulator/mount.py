"""From the table to the sensor's package: where it points, and gravity as it feels it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calrig.simulator.config import MountOptions
from calrig.simulator.trajectory import FloatArray, Trajectory, Turn, trapezoid

STANDARD_GRAVITY_MPS2 = 9.80665
RELAXATIONS_S = np.logspace(-2.0, 8.0, 21)
"""Retardation times of a joint's springs and dampers, two a decade: it creeps from 10 ms to years."""


CLAMP_VELOCITY_DPS, CLAMP_ACCELERATION_DPS2 = 60.0, 120.0
"""Of the person or dividing head that turns the package in its clamp."""
FACES = {
    "x": np.eye(3),
    "y": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "z": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
}
"""From the clamp's axes to the package's, the named one of which lies along the stage's axis.

At 0° z is up, then x, then y. Reversed faces are turned by half a turn about that vertical.
"""
REVERSED = np.diag([-1.0, -1.0, 1.0])


class Clamping(NamedTuple):
    """From an instant on: the matrix (3, 3) from the clamp's axes to the sensor's."""

    from_s: float
    to_sensor: FloatArray


class Mount:
    """A package in a clamp on a table: it may sit askew, slip, bend under a cable, and be remounted.

    Args:
        options: of it.
        rng: draws how well each clamping is seated.
    """

    def __init__(self, options: MountOptions, rng: np.random.Generator | None = None) -> None:
        self._options = options
        self._rng = rng or np.random.default_rng(0)
        self._in_case = _about("x", options.roll_deg) @ _about("y", options.pitch_deg)
        self._in_case = self._in_case @ _about("z", options.yaw_deg)
        self._clamp = Trajectory(options.clamped_deg)
        self._clampings = [self._seated(-math.inf, options.clamped_axis)]

    def clamp(self, at_s: float, mount_deg: float, axis: str) -> float:
        """Turns the package in its clamp, or puts it in by another face; returns when that is done."""
        from_deg = self._clamp.state(at_s)[0]
        way = trapezoid(at_s, from_deg, mount_deg, CLAMP_VELOCITY_DPS, CLAMP_ACCELERATION_DPS2)
        self._clamp.replace_from(at_s, way)
        self._clampings.append(self._seated(way[-1].start_s, axis))
        return way[-1].start_s

    def _seated(self, from_s: float, axis: str) -> Clamping:
        """A clamping by a face, each seated as well as it happens."""
        seat = self._rng.normal(0.0, self._options.seat_std_deg, 3)
        askew = _about("x", seat[0]) @ _about("y", seat[1]) @ _about("z", seat[2])
        face = FACES[axis[-1]] @ (REVERSED if axis.startswith("-") else np.eye(3))
        return Clamping(from_s, self._in_case @ face @ askew)

    def _to_sensor(self, times_s: FloatArray | None) -> FloatArray:
        """(3, 3), or (n, 3, 3) if the package was remounted in between."""
        if len(self._clampings) == 1 or times_s is None:
            return self._clampings[0].to_sensor
        begins = [clamping.from_s for clamping in self._clampings]
        chosen = np.searchsorted(begins, times_s, side="right") - 1
        return np.array([clamping.to_sensor for clamping in self._clampings])[chosen]

    def package(self, table: Turn, times_s: FloatArray) -> Turn:
        """The clamp's turn about the stage's axis, the angle at which the package is clamped included."""
        clamp = self._clamp.at(times_s)
        parts = table, clamp, self._sag(table), self._slip(times_s), self._creep(times_s)
        angle_deg = sum((part.angle_deg for part in parts), np.full_like(times_s, self._options.offset_deg))
        return Turn(angle_deg, sum((part.rate_dps for part in parts), np.zeros_like(times_s)))

    def specific_force_g(self, angle_deg: FloatArray, times_s: FloatArray | None = None) -> FloatArray:
        """Gravity's reaction along the sensor's axes, (n, 3): the vertical turned, its length always 1 g.

        `times_s` (n,) tells which clamping it was; without, the first.
        """
        tilt, angle = math.radians(self._options.axis_tilt_deg), np.radians(angle_deg)
        along_axis = np.full_like(angle, math.sin(tilt))
        up = np.stack([along_axis, math.cos(tilt) * np.sin(angle), math.cos(tilt) * np.cos(angle)], axis=-1)
        felt: FloatArray = np.einsum("...ij,...j->...i", self._to_sensor(times_s), up)
        return felt

    def angular_rate_dps(self, rate_dps: FloatArray, times_s: FloatArray | None = None) -> FloatArray:
        """The turn about the stage's axis along the sensor's axes, (n, 3)."""
        rates: FloatArray = rate_dps[..., None] * self._to_sensor(times_s)[..., 0]
        return rates

    def from_table(self, vectors: FloatArray, times_s: FloatArray) -> FloatArray:
        """Vectors (..., n, 3) that turn with the table, along the sensor's axes.

        They are given along the stage's axis, tangential, and radial, upward with the table at 0.
        """
        turned = np.radians(self._clamp.at(times_s).angle_deg)
        along, tangential, radial = np.moveaxis(vectors, -1, 0)
        s, c = np.sin(turned), np.cos(turned)
        in_clamp = np.stack([along, c * tangential + s * radial, c * radial - s * tangential], axis=-1)
        felt: FloatArray = np.einsum("...ij,...j->...i", self._to_sensor(times_s), in_clamp)
        return felt

    def swing_g(self, rate_dps: FloatArray, rate_change_dps2: FloatArray, times_s: FloatArray) -> FloatArray:
        """What turning on an arm adds to the specific force (n, 3): tangential and centripetal."""
        arm = self._options.lever_arm_m / STANDARD_GRAVITY_MPS2
        tangential, radial = -arm * np.radians(rate_change_dps2), -arm * np.radians(rate_dps) ** 2
        return self.from_table(np.stack([np.zeros_like(radial), tangential, radial], axis=-1), times_s)

    def _sag(self, table: Turn) -> Turn:
        """What the cable bends: its weight on its arm, and its winding up, each against the motion upward."""
        options = self._options
        moment_nm = options.cable_mass_kg * STANDARD_GRAVITY_MPS2 * options.cable_arm_m
        lean = np.radians(table.angle_deg - options.cable_horizontal_deg)
        stiffness = options.cable_stiffness_nm_per_deg
        torque_nm = -moment_nm * np.cos(lean) - stiffness * table.angle_deg
        slope = np.radians(moment_nm) * np.sin(lean) - stiffness
        compliance = options.compliance_deg_per_nm
        return Turn(compliance * torque_nm, compliance * slope * table.rate_dps)

    def _slip(self, times_s: FloatArray) -> Turn:
        """A step that takes `slip_s`, smooth at both ends, so that a gyro feels it."""
        options = self._options
        done = np.clip((times_s - options.slip_at_s) / options.slip_s, 0.0, 1.0)
        return Turn(
            options.slip_deg * done**2 * (3 - 2 * done),
            options.slip_deg / options.slip_s * 6 * done * (1 - done),
        )

    def _creep(self, times_s: FloatArray) -> Turn:
        """Kelvin-Voigt elements in a row, all under the clamp's constant load: a spring and a damper each."""
        options = self._options
        if not options.creep_deg_per_decade:
            return Turn(np.zeros_like(times_s), np.zeros_like(times_s))
        under_load_s = np.maximum(times_s - options.creep_began_s, 0.0)[..., None]
        gives_deg = options.creep_deg_per_decade * math.log10(RELAXATIONS_S[1] / RELAXATIONS_S[0])
        left = np.exp(-under_load_s / RELAXATIONS_S)
        loaded = under_load_s > 0.0
        return Turn(
            (gives_deg * (1.0 - left)).sum(axis=-1),
            (gives_deg * loaded * left / RELAXATIONS_S).sum(axis=-1),
        )


def _about(axis: str, angle_deg: float) -> FloatArray:
    """A vector's components along axes that were turned by this angle about one of themselves.

    Turned about x the elevation rises by it.
    """
    s, c = math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))
    k = "xyz".index(axis)
    turned = np.eye(3)
    i, j = (k + 1) % 3, (k + 2) % 3
    turned[i, i], turned[i, j], turned[j, i], turned[j, j] = c, s, -s, c
    return turned
