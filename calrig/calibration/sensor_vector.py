"""The vector that an accelerometer makes of gravity, with the errors of its two axes across the stage's.

At an elevation φ of the sensor itself a faultless one measures a_y = sin φ and a_z = cos φ (g). An error δ of
a_y and ε of a_z turns the angle atan2(a_y, a_z) by atan2(δ·c − ε·s, 1 + δ·s + ε·c). Errors of several effects
add up before they turn it: an offset of 80 mg beside a gain of 3 % is 0.14° off where each turns it alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray

VectorError = tuple[FloatArray | float, FloatArray | float]
"""What is added to a_y and to a_z, g: (n,) each, or a number for all."""

TURNS_THE_SENSOR = frozenset({"stage", "mounting", "environment"})
"""Origins of effects that turn the sensor itself: its axes err at the elevation that they leave."""


@dataclass(frozen=True, slots=True)
class VectorInC:
    """C expressions of what is added to a_y and to a_z, g."""

    y_g: str
    z_g: str


def sin_cos(felt_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) a_y and a_z of a sensor without errors at elevations in degrees, g."""
    angle = np.radians(felt_deg)
    return np.sin(angle), np.cos(angle)


def turned_vector(felt_deg: FloatArray, error: VectorError) -> tuple[FloatArray, FloatArray]:
    """What errors of all effects together do to the measured vector.

    Args:
        felt_deg: (n,) elevation of the sensor, degrees.
        error: of a_y and a_z, g.

    Returns:
        (n,) the angle by which it turns, degrees, and (n,) its length, g.
    """
    s, c = sin_cos(felt_deg)
    across, along = error[0] * c - error[1] * s, 1.0 + error[0] * s + error[1] * c
    return np.degrees(np.arctan2(across, along)), np.hypot(across, along)
