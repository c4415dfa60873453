"""From the table to the sensor's package: where it points, and gravity as it feels it."""

from __future__ import annotations

import math

import numpy as np

from calrig.simulator.config import MountOptions
from calrig.simulator.trajectory import FloatArray, Turn

STANDARD_GRAVITY_MPS2 = 9.80665
RELAXATIONS_S = np.logspace(-2.0, 8.0, 21)
"""Retardation times of a joint's springs and dampers, two a decade: it creeps from 10 ms to years."""


class Mount:
    """A package on a table that may sit askew, slip, and bend under a cable."""

    def __init__(self, options: MountOptions) -> None:
        self._options = options
        yaw, pitch = math.radians(options.yaw_deg), math.radians(options.pitch_deg)
        about_z = [[math.cos(yaw), math.sin(yaw), 0], [-math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]]
        about_y = [[math.cos(pitch), 0, -math.sin(pitch)], [0, 1, 0], [math.sin(pitch), 0, math.cos(pitch)]]
        self._from_table = np.array(about_y) @ np.array(about_z)

    def package(self, table: Turn, times_s: FloatArray) -> Turn:
        """The package's turn about the stage's axis."""
        parts = table, self._sag(table), self._slip(times_s), self._creep(times_s)
        angle_deg = sum((part.angle_deg for part in parts), np.full_like(times_s, self._options.offset_deg))
        return Turn(angle_deg, sum((part.rate_dps for part in parts), np.zeros_like(times_s)))

    def specific_force_g(self, angle_deg: FloatArray) -> FloatArray:
        """Gravity's reaction along the package's axes, (n, 3): the vertical turned, its length always 1 g."""
        tilt, angle = math.radians(self._options.axis_tilt_deg), np.radians(angle_deg)
        along_axis = np.full_like(angle, math.sin(tilt))
        up = np.stack([along_axis, math.cos(tilt) * np.sin(angle), math.cos(tilt) * np.cos(angle)], axis=-1)
        felt: FloatArray = up @ self._from_table.T
        return felt

    def angular_rate_dps(self, rate_dps: FloatArray) -> FloatArray:
        """The turn about the stage's axis along the package's axes, (n, 3)."""
        rates: FloatArray = rate_dps[..., None] * self._from_table[:, 0]
        return rates

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
