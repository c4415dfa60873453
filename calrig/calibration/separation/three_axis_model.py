"""What a whole accelerometer makes of gravity's direction, with all derivatives; g and radians.

    a = b + b_per_c·ΔT + (1 + gain)·u + q·u² + c·u³,  u = S·g

Each line is of one axis. S is upper triangular with ones on its diagonal: the frame of g is then the sensor's
own, its z along the sensor's z, its y in the plane of y and z. Each axis is nonlinear in what acts along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calrig.calibration.effects.accelerometer_offset import LARGEST_MG
from calrig.calibration.effects.axis_mismatch import LARGEST_GAIN_PCT, LARGEST_SKEW_DEG
from calrig.calibration.effects.temperature_offset import LARGEST_MG_PER_C
from calrig.calibration.separation.unit_model import LARGEST_CURVATURE_G
from calrig.estimation.angles import AXES, FloatArray

BIAS, GAIN, SKEW = slice(0, 3), slice(3, 6), slice(6, 9)
QUADRATIC, CUBIC, PER_C = slice(9, 12), slice(12, 15), slice(15, 18)
WIDTH = 18
"""Parameters of a unit: three of each kind, x, y, z; skews xy, xz, yz."""
SKEWS = ((0, 1), (0, 2), (1, 2))
"""Row and column of each skew in S."""
NAMES = tuple(
    f"{axes} {what}"
    for what, of in (
        ("offset", AXES),
        ("gain", AXES),
        ("skew", ("xy", "xz", "yz")),
        ("quadratic term", AXES),
        ("cubic term", AXES),
        ("offset's temperature", AXES),
    )
    for axes in of
)
LARGEST = np.repeat(
    [
        LARGEST_MG / 1000.0,
        LARGEST_GAIN_PCT / 100.0,
        math.radians(LARGEST_SKEW_DEG),
        LARGEST_CURVATURE_G,
        LARGEST_CURVATURE_G,
        LARGEST_MG_PER_C / 1000.0,
    ],
    3,
)
"""How large each may be in any part that is sold."""


@dataclass(frozen=True, slots=True, eq=False)
class SensedVector:
    """A unit's vectors at n directions of gravity.

    Attributes:
        vector_g: (n, 3).
        by_direction: (n, 3, 3) its derivative by each component of the direction.
        by_parameters: (n, 3, 18).
    """

    vector_g: FloatArray
    by_direction: FloatArray
    by_parameters: FloatArray


def sensed_vector(
    parameters: FloatArray, direction: FloatArray, warmer_c: FloatArray | float = 0.0
) -> SensedVector:
    """The vectors of one unit.

    Args:
        parameters: (18,).
        direction: (n, 3) upward, of length 1, in the sensor's own frame.
        warmer_c: (n,) die temperature less the unit's reference.
    """
    askew = skewed(parameters)
    along = direction @ askew.T
    warmer = np.broadcast_to(np.asarray(warmer_c, dtype=np.float64), (len(direction),))
    size, quadratic, cubic = 1.0 + parameters[GAIN], parameters[QUADRATIC], parameters[CUBIC]
    vector = (
        parameters[BIAS]
        + parameters[PER_C] * warmer[:, None]
        + size * along
        + quadratic * along**2
        + cubic * along**3
    )
    steep = size + 2.0 * quadratic * along + 3.0 * cubic * along**2
    by = np.zeros((len(direction), 3, WIDTH))
    of_axes = np.arange(3)
    for at, column in ((BIAS, 1.0), (GAIN, along), (QUADRATIC, along**2), (CUBIC, along**3)):
        by[:, of_axes, at.start + of_axes] = column
    by[:, of_axes, PER_C.start + of_axes] = warmer[:, None]
    for k, (row, column_of) in enumerate(SKEWS):
        by[:, row, SKEW.start + k] = steep[:, row] * direction[:, column_of]
    return SensedVector(vector, steep[:, :, None] * askew, by)


def skewed(parameters: FloatArray) -> FloatArray:
    """(3, 3) S."""
    askew = np.eye(3)
    for (row, column), skew in zip(SKEWS, parameters[SKEW], strict=True):
        askew[row, column] = skew
    return askew


def response(parameters: FloatArray) -> FloatArray:
    """(3, 3) what the unit makes of a specific force, curvatures aside: diag(1 + gain)·S."""
    return np.asarray((1.0 + parameters[GAIN])[:, None] * skewed(parameters))
