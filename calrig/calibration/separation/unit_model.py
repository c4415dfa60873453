"""What one unit's accelerometer makes of gravity at an elevation φ, with all derivatives; radians and g.

    a_y = (1 + κ)·(1 + gain)·u + y + y_per_c·ΔT + y2·u² + y3·u³,  u = sin φ + cos φ·sin skew
    a_z = (1 + κ)·cos φ + z + z_per_c·ΔT + z2·cos² φ + z3·cos³ φ

κ is the gain that both axes have in common, seen in |a| alone. Each axis is nonlinear in what acts along it
(u along y, which lies askew): a polynomial of the angle would be none of a unit that goes through the turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calrig.calibration.effects.accelerometer_offset import LARGEST_MG
from calrig.calibration.effects.axis_mismatch import LARGEST_GAIN_PCT, LARGEST_SKEW_DEG
from calrig.calibration.effects.temperature_offset import LARGEST_MG_PER_C
from calrig.estimation.angles import FloatArray

NAMES = ("common_gain", "gain", "skew", "y", "z", "y2", "y3", "z2", "z3", "y_per_c", "z_per_c")
LARGEST_CURVATURE_G = 0.05
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: nonlinearity 0.5 %; ten times as much."""
LARGEST = np.array(
    [
        *[LARGEST_GAIN_PCT / 100.0] * 2,
        math.radians(LARGEST_SKEW_DEG),
        *[LARGEST_MG / 1000.0] * 2,
        *[LARGEST_CURVATURE_G] * 4,
        *[LARGEST_MG_PER_C / 1000.0] * 2,
    ]
)
"""How large each may be in any part that is sold: what is not known of a parameter before the data."""
CURVATURES = tuple(NAMES.index(name) for name in ("y2", "y3", "z2", "z3"))
PER_C = tuple(NAMES.index(name) for name in ("y_per_c", "z_per_c"))
OF_LINEAR, OF_CUBIC = 2, 4
"""Highest order of the turn that a unit's error of angle has: offsets 1, gains and skew 2, cubic terms 4."""


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """A unit's vector at n elevations.

    Attributes:
        vector_g: (n, 2) a_y and a_z.
        by_elevation: (n, 2) its derivative by φ, g/rad.
        by_parameters: (n, 2, 11) by each of `NAMES`.
    """

    vector_g: FloatArray
    by_elevation: FloatArray
    by_parameters: FloatArray

    def angle(self) -> FloatArray:
        """(n,) atan2(a_y, a_z), rad."""
        return np.arctan2(self.vector_g[:, 0], self.vector_g[:, 1])

    def turned(self, change: FloatArray) -> FloatArray:
        """(n, …) what small changes (n, 2, …) of the vector do to its angle, rad."""
        y, z = (self.vector_g[:, k].reshape(-1, *[1] * (change.ndim - 2)) for k in (0, 1))
        return np.asarray((z * change[:, 0] - y * change[:, 1]) / (y * y + z * z))


def sensed(parameters: FloatArray, elevation: FloatArray, warmer_c: FloatArray | float = 0.0) -> Sensed:
    """The vector of one unit, or of as many as there are poses.

    Args:
        parameters: (11,) as `NAMES`, or (11, n) those of each pose's own unit.
        elevation: (n,) φ, rad.
        warmer_c: (n,) die temperature less the unit's reference.
    """
    common, gain, skew, y, z, y2, y3, z2, z3, y_per_c, z_per_c = parameters
    s, c = np.sin(elevation), np.cos(elevation)
    size, both = 1.0 + common, (1.0 + common) * (1.0 + gain)
    along, across = s + c * np.sin(skew), c - s * np.sin(skew)
    vector = np.stack(
        [
            both * along + y + y_per_c * warmer_c + y2 * along**2 + y3 * along**3,
            size * c + z + z_per_c * warmer_c + z2 * c**2 + z3 * c**3,
        ],
        axis=1,
    )
    steep_y = both + 2.0 * y2 * along + 3.0 * y3 * along**2
    steep_z = size + 2.0 * z2 * c + 3.0 * z3 * c**2
    by_elevation = np.stack([steep_y * across, -steep_z * s], axis=1)
    by = np.zeros((len(elevation), 2, len(NAMES)))
    by[:, 0, 0], by[:, 1, 0] = (1.0 + gain) * along, c
    by[:, 0, 1] = size * along
    by[:, 0, 2] = steep_y * c * np.cos(skew)
    by[:, 0, 3], by[:, 1, 4] = 1.0, 1.0
    by[:, 0, 5], by[:, 0, 6] = along**2, along**3
    by[:, 1, 7], by[:, 1, 8] = c**2, c**3
    by[:, 0, 9], by[:, 1, 10] = warmer_c, warmer_c
    return Sensed(vector, by_elevation, by)
