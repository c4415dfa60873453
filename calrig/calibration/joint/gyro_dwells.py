"""A gyro's bias and its sensitivity to gravity, from its means while the stage stands.

    mean = bias + per_c·ΔT + D·g + h·n + k·(g × n)

g is gravity's direction, n the stage's axis, both in the unit; h and k are Earth's rate along the axis and
level across it, no more than 0.0042 dps each. Its rate about the vertical turns with g and cannot be told
from D: up to 0.0042 dps/g of D's diagonal is Earth's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.three_axis_fit import UNTOLD, ThreeAxisFit
from calrig.calibration.pose import GYRO_MEANS
from calrig.estimation.angles import FloatArray

EARTH_DPS = 15.041 / 3600.0
"""IERS Conventions 2010, chapter 1: 7.292115e−5 rad/s."""
LARGEST_BIAS_DPS, LARGEST_DPS_PER_G, LARGEST_DPS_PER_C = 100.0, 1.0, 1.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.1: ±20 dps, 0.1 dps/g; several times as much."""
FEWEST = 8
LEAST_DPS = 1e-6
BIAS, PER_G, PER_C, EARTH = slice(0, 3), slice(3, 12), slice(12, 15), slice(15, 17)
WIDTHS = np.repeat([LARGEST_BIAS_DPS, LARGEST_DPS_PER_G, LARGEST_DPS_PER_C, EARTH_DPS], [3, 9, 3, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Dwells:
    """Of a gyro, in the sensor's frame.

    Attributes:
        bias_dps, bias_std_dps: (3,) at no acceleration, and at the unit's reference temperature.
        dps_per_g, dps_per_g_std: (3, 3) of the gyro's axes (rows) by directions of acceleration.
        told: whether the poses tell `dps_per_g` and so the bias.
        left_dps: (poses, 3) what each dwell's mean differs by; 0 of those that have none.
    """

    bias_dps: FloatArray
    bias_std_dps: FloatArray
    dps_per_g: FloatArray
    dps_per_g_std: FloatArray
    told: bool
    left_dps: FloatArray


def dwells_of(fit: ThreeAxisFit, unit: int) -> Dwells | None:
    """What a unit's dwells say; None where too few of them have all three means."""
    problem = fit.problem
    means = [[pose.covariates.get(name) for name in GYRO_MEANS] for pose in problem.of.poses]
    known = np.array([None not in mean for mean in means]) & fit.kept & (problem.table.unit == unit)
    rows = np.flatnonzero(known)
    if len(rows) < FEWEST:
        return None
    measured = np.array([means[row] for row in rows], dtype=np.float64)
    mounts = problem.table.mount[rows]
    axes = np.stack([problem.clamped(fit.parameters, k)[:, 0] for k in range(len(problem.table.mounts))])
    up, warmer = problem.directions(fit.parameters)[rows], problem.table.warmer_c[rows]
    design = np.zeros((len(rows), 3, len(WIDTHS)))
    for axis in range(3):
        design[:, axis, BIAS.start + axis] = 1.0
        design[:, axis, PER_G.start + 3 * axis : PER_G.start + 3 * axis + 3] = up
        design[:, axis, PER_C.start + axis] = warmer
    design[:, :, EARTH.start] = axes[mounts]
    design[:, :, EARTH.start + 1] = np.cross(up, axes[mounts])
    flat, response = design.reshape(-1, len(WIDTHS)), measured.ravel()
    variance = LEAST_DPS**2
    for _ in range(3):
        inverse = np.linalg.inv(flat.T @ flat / variance + np.diag(WIDTHS**-2.0))
        values = inverse @ (flat.T @ response) / variance
        left = response - flat @ values
        variance = max(float(left @ left) / max(len(left) - len(WIDTHS), 1), LEAST_DPS**2)
    stds, left_dps = np.sqrt(np.diag(inverse)), np.zeros((len(problem.table), 3))
    left_dps[rows] = left.reshape(-1, 3)
    return Dwells(
        values[BIAS],
        stds[BIAS],
        values[PER_G].reshape(3, 3),
        stds[PER_G].reshape(3, 3),
        bool((stds[PER_G] < UNTOLD * LARGEST_DPS_PER_G).all()),
        left_dps,
    )
