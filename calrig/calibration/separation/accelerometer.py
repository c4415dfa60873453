"""An accelerometer at rest: its vector by gravity's direction, with all derivatives; g and radians.

    a = b + b_per_c·ΔT + (1 + gain)·u + q·u² + c·u³ + f·u⁴,  u = S·g

Each line is of one axis. S is upper triangular with ones on its diagonal: the frame of g is then the sensor's
own, its z along the sensor's z, its y in the plane of y and z. Each axis is nonlinear in what acts along it:
a polynomial of the angle would be none of a unit that goes through the turn.

A unit that turns about its x axis alone shows the parameters `IN_PLANE`; the others are then fixed at 0. The
effects of the catalogue state those as `PLANE_NAMES` has them: the gain of z is common to both axes, that of
y is relative to it, and the skew is an angle.
"""

import math
from dataclasses import dataclass

import numpy as np

from calrig.calibration.effects.accelerometer_offset import LARGEST_MG
from calrig.calibration.effects.axis_mismatch import LARGEST_GAIN_PCT, LARGEST_SKEW_DEG
from calrig.calibration.effects.temperature_offset import LARGEST_MG_PER_C
from calrig.estimation.angles import AXES, FloatArray

BIAS, GAIN, SKEW = slice(0, 3), slice(3, 6), slice(6, 9)
QUADRATIC, CUBIC, PER_C = slice(9, 12), slice(12, 15), slice(15, 18)
QUARTIC = slice(18, 21)
WIDTH = 21
"""Parameters of a unit: three of each kind, x, y, z; skews xy, xz, yz."""
SKEWS = ((0, 1), (0, 2), (1, 2))
"""Row and column of each skew in S."""
IN_PLANE = np.array([k for k in range(WIDTH) if k % 3 != 0 and k != SKEW.start + 1])
"""Places of what a rotation about x shows: of y and z, and the skew yz."""
NAMES = tuple(
    f"{axes} {what}"
    for what, of in (
        ("offset", AXES),
        ("gain", AXES),
        ("skew", ("xy", "xz", "yz")),
        ("quadratic term", AXES),
        ("cubic term", AXES),
        ("offset's temperature", AXES),
        ("quartic term", AXES),
    )
    for axes in of
)
LARGEST_CURVATURE_G = 0.05
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: nonlinearity 0.5 %; ten times as much."""
LARGEST = np.repeat(
    [
        LARGEST_MG / 1000.0,
        LARGEST_GAIN_PCT / 100.0,
        math.radians(LARGEST_SKEW_DEG),
        LARGEST_CURVATURE_G,
        LARGEST_CURVATURE_G,
        LARGEST_MG_PER_C / 1000.0,
        LARGEST_CURVATURE_G,
    ],
    3,
)
"""How large each may be in any part that is sold: what is not known of a parameter before the data."""
PLANE_NAMES = (
    "common_gain",
    "gain",
    "skew",
    "y",
    "z",
    "y2",
    "y3",
    "z2",
    "z3",
    "y_per_c",
    "z_per_c",
    "y4",
    "z4",
)
PLANE_CURVATURES = tuple(PLANE_NAMES.index(name) for name in ("y2", "y3", "z2", "z3", "y4", "z4"))
PLANE_QUARTIC = tuple(PLANE_NAMES.index(name) for name in ("y4", "z4"))
PLANE_PER_C = tuple(PLANE_NAMES.index(name) for name in ("y_per_c", "z_per_c"))
_SAME = {
    "y": 1,
    "z": 2,
    "y2": 10,
    "y3": 13,
    "z2": 11,
    "z3": 14,
    "y_per_c": 16,
    "z_per_c": 17,
    "y4": 19,
    "z4": 20,
}
"""Of `PLANE_NAMES` those that are parameters of the unit themselves, and their places."""
OF_LINEAR, OF_CUBIC, OF_QUARTIC = 2, 4, 5
"""Highest order of the turn that a unit's error of angle has: offsets 1, gains and skew 2, cubic terms 4,
quartic terms 5.
"""


@dataclass(frozen=True, slots=True, eq=False)
class SensedVector:
    """Vectors at n directions of gravity.

    Attributes:
        vector_g: (n, 3).
        by_direction: (n, 3, 3) its derivative by each component of the direction.
        by_parameters: (n, 3, 21).
    """

    vector_g: FloatArray
    by_direction: FloatArray
    by_parameters: FloatArray


def sensed_vector(
    parameters: FloatArray, direction: FloatArray, warmer_c: FloatArray | float = 0.0
) -> SensedVector:
    """Return the vectors of one unit, or of as many as there are directions.

    Args:
        parameters: (21,), or (n, 21) those of each direction's own unit.
        direction: (n, 3) upward, of length 1, in the sensor's own frame.
        warmer_c: (n,) die temperature less the unit's reference.
    """
    askew = skewed(parameters)
    along = np.einsum("...ij,...j->...i", askew, direction)
    warmer = np.broadcast_to(np.asarray(warmer_c, dtype=np.float64), (len(direction),))
    size, quadratic, cubic, quartic = (
        1.0 + parameters[..., GAIN],
        parameters[..., QUADRATIC],
        parameters[..., CUBIC],
        parameters[..., QUARTIC],
    )
    vector = (
        parameters[..., BIAS]
        + parameters[..., PER_C] * warmer[:, None]
        + size * along
        + quadratic * along**2
        + cubic * along**3
        + quartic * along**4
    )
    steep = size + 2.0 * quadratic * along + 3.0 * cubic * along**2 + 4.0 * quartic * along**3
    by = np.zeros((len(direction), 3, WIDTH))
    of_axes = np.arange(3)
    powers = (BIAS, 1.0), (GAIN, along), (QUADRATIC, along**2), (CUBIC, along**3), (QUARTIC, along**4)
    for at, column in powers:
        by[:, of_axes, at.start + of_axes] = column
    by[:, of_axes, PER_C.start + of_axes] = warmer[:, None]
    for k, (row, column_of) in enumerate(SKEWS):
        by[:, row, SKEW.start + k] = steep[:, row] * direction[:, column_of]
    return SensedVector(vector, steep[:, :, None] * askew, by)


def skewed(parameters: FloatArray) -> FloatArray:
    """(…, 3, 3) S."""
    askew = np.zeros((*parameters.shape[:-1], 3, 3))
    askew[..., range(3), range(3)] = 1.0
    for k, (row, column) in enumerate(SKEWS):
        askew[..., row, column] = parameters[..., SKEW.start + k]
    return askew


def response(parameters: FloatArray) -> FloatArray:
    """(3, 3) what the unit makes of a specific force, curvatures aside: diag(1 + gain)·S."""
    return np.asarray((1.0 + parameters[GAIN])[:, None] * skewed(parameters))


@dataclass(frozen=True, slots=True, eq=False)
class PlaneVector:
    """What y and z of a unit make of n elevations.

    Attributes:
        vector_g: (n, 2) a_y and a_z.
        by_elevation: (n, 2) its derivative by the elevation, g/rad.
        by_parameters: (n, 2, 13) by each of `PLANE_NAMES`.
    """

    vector_g: FloatArray
    by_elevation: FloatArray
    by_parameters: FloatArray

    def angle(self) -> FloatArray:
        """(n,) atan2(a_y, a_z), rad."""
        return np.arctan2(self.vector_g[:, 0], self.vector_g[:, 1])

    def turned(self, change: FloatArray) -> FloatArray:
        """(n, …) what small changes (n, 2, …) of the vector do to its angle, rad."""
        return turned(self.vector_g, change)


def turned(vector_g: FloatArray, change: FloatArray) -> FloatArray:
    """(n, …) what small changes (n, 2, …) of vectors (n, 2) do to their angle atan2(first, second), rad."""
    y, z = (vector_g[:, k].reshape(-1, *[1] * (change.ndim - 2)) for k in (0, 1))
    return np.asarray((z * change[:, 0] - y * change[:, 1]) / (y * y + z * z))


def plane_vector(own: FloatArray, elevation: FloatArray, warmer_c: FloatArray | float = 0.0) -> PlaneVector:
    """Return the vector of one unit about its x axis.

    Args:
        own: (13,) as `PLANE_NAMES`.
        elevation: (n,) rad.
        warmer_c: (n,) die temperature less the unit's reference.
    """
    common, gain, skew = own[:3]
    whole, slopes = np.zeros(WIDTH), np.zeros((WIDTH, len(PLANE_NAMES)))
    whole[GAIN] = 0.0, (1.0 + common) * (1.0 + gain) - 1.0, common
    whole[SKEW.stop - 1] = np.sin(skew)
    slopes[GAIN, 0] = 0.0, 1.0 + gain, 1.0
    slopes[GAIN.start + 1, 1] = 1.0 + common
    slopes[SKEW.stop - 1, 2] = np.cos(skew)
    for name, place in _SAME.items():
        k = PLANE_NAMES.index(name)
        whole[place], slopes[place, k] = own[k], 1.0
    s, c, nil = np.sin(elevation), np.cos(elevation), np.zeros(len(elevation))
    found = sensed_vector(whole, np.stack([nil, s, c], axis=1), warmer_c)
    by_elevation = np.einsum("nij,nj->ni", found.by_direction, np.stack([nil, c, -s], axis=1))
    return PlaneVector(found.vector_g[:, 1:], by_elevation[:, 1:], found.by_parameters[:, 1:] @ slopes)


def plane_parameters(own: FloatArray, axis: FloatArray) -> FloatArray:
    """(13,) of a unit (21,) that turns about an axis (3,), its elevation 0 where its z has most of 1 g."""
    up = np.eye(3)[2] - axis[2] * axis
    up /= np.linalg.norm(up)
    level = np.cross(up, axis)
    along_y, along_z = skewed(own)[1], skewed(own)[2]
    by_level, by_up, size_z = along_y @ level, along_y @ up, along_z @ up
    common = (1.0 + own[GAIN][2]) * size_z - 1.0
    gain = (1.0 + own[GAIN][1]) * by_level / (1.0 + common) - 1.0
    quadratic, cubic, quartic = own[QUADRATIC], own[CUBIC], own[QUARTIC]
    return np.array(
        [
            common,
            gain,
            np.arcsin(by_up / by_level),
            own[BIAS][1],
            own[BIAS][2],
            quadratic[1] * by_level**2,
            cubic[1] * by_level**3,
            quadratic[2] * size_z**2,
            cubic[2] * size_z**3,
            own[PER_C][1],
            own[PER_C][2],
            quartic[1] * by_level**4,
            quartic[2] * size_z**4,
        ]
    )
