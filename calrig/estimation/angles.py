"""Angles in degrees: wrapping, the elevation that gravity gives, and a robust standard deviation."""

import math
from typing import overload

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]
Intp = npt.NDArray[np.intp]


@overload
def wrap_deg(angle_deg: float) -> float: ...
@overload
def wrap_deg(angle_deg: FloatArray) -> FloatArray: ...
def wrap_deg(angle_deg: float | FloatArray) -> float | FloatArray:
    """Return the same direction within (−180, 180] degrees; an angle already there comes back bit for bit."""
    if isinstance(angle_deg, np.ndarray):
        turns = np.ceil((angle_deg - 180.0) / 360.0)
        return np.asarray(angle_deg - 360.0 * turns, dtype=np.float64)
    return angle_deg - 360.0 * math.ceil((angle_deg - 180.0) / 360.0)


AXES = "xyz"
STANDARD_GRAVITY_MPS2 = 9.80665
"""1 g (3rd CGPM, 1901)."""


def along_axis(vectors: FloatArray, axis: str) -> FloatArray:
    """Return (n, 3) the same vectors with the named axis first and the others following in turn.

    So that `elevation_deg` is the angle about that axis: 0° is z up about x, x up about y, y up about z.
    """
    return np.roll(vectors, -AXES.index(axis[-1]), axis=1)


def elevation_deg(accel_g: FloatArray) -> FloatArray:
    """Return elevation about the sensor's x axis, atan2(accel_y, accel_z); 0° is z up (CONTRACT section 4).

    `accel_g` (n, 3) is specific force along x, y, z; any one unit will do.

    Returns:
        (n,) degrees in [−180, 180].
    """
    return np.degrees(np.arctan2(accel_g[:, 1], accel_g[:, 2]))


MAD_TO_STD = 1.4826
"""Standard deviation over the median absolute deviation, of normal values: 1/Φ⁻¹(3/4)."""


def robust_std(values: FloatArray) -> float:
    """Return the standard deviation by the median absolute deviation, in the values' unit.

    `values` are (n,), n >= 1.
    """
    return MAD_TO_STD * float(np.median(np.abs(values - np.median(values))))
