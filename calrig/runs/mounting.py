"""Check by gravity how the unit is clamped on the stage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.poses import Pose
from calrig.estimation.angles import AXES, along_axis, elevation_deg, wrap_deg
from calrig.instruments.types import FloatArray
from calrig.model.plan import MountAxis
from calrig.model.run import Mount

MOST_OFF_DEG = 5.0
"""CONTRACT section 2. A hand clamps to a degree."""
ROUNDS = 4
MOST_ALONG_G = 0.5
"""An axis that lies along a level stage's feels nothing of gravity; leaning by 30° it feels this much."""


ERRORS_STD_DEG = np.array([2.0, 5.0, 5.0, 1.0, 1.0])
"""Of an uncalibrated unit: a mount by hand; offsets of 80 mg, by cosine and sine; gain and skew of 3 %."""
POSE_STD_DEG = 0.5
"""Of a reading against that, the stage's error in it."""


class OwnErrors:
    """What a unit's own accelerometer does to its reading, as far as the poses of a run so far tell.

    Offsets of 80 mg turn its gravity by 5°, at 120° the other way than at 0°: without this a unit that is
    clamped right would be sent back. A ridge fit: of a unit without poses nothing is known.

    Args:
        poses: so far, at whichever mounts.
        sense: in which the unit turns with the stage.
    """

    def __init__(self, poses: Sequence[Pose] = (), sense: int = 1) -> None:
        theta = np.array([sense * pose.theta_deg for pose in poses], dtype=np.float64)
        error = wrap_deg(np.array([pose.reading_deg for pose in poses], dtype=np.float64) - theta)
        design = _harmonics(theta) / POSE_STD_DEG
        weight = design.T @ design + np.diag(ERRORS_STD_DEG**-2)
        self._values = np.linalg.solve(weight, design.T @ (error / POSE_STD_DEG))

    def without_deg(self, reading_deg: float) -> float:
        """The angle at which the unit gives a reading."""
        angle_deg = reading_deg
        for _ in range(ROUNDS):
            angle_deg = reading_deg - float(_harmonics(np.array([angle_deg]))[0] @ self._values)
        return angle_deg


def _harmonics(theta_deg: FloatArray) -> FloatArray:
    """(n, 5) 1, cosine and sine of the angle, and of twice the angle."""
    theta = np.radians(theta_deg)
    columns = (np.ones(len(theta)), np.cos(theta), np.sin(theta), np.cos(2 * theta), np.sin(2 * theta))
    return np.stack(columns, axis=1)


@dataclass(frozen=True, slots=True)
class Mounting:
    """The angle at which a unit is to be clamped, and which of its axes lies along the stage's."""

    deg: float
    axis: MountAxis = "x"

    @property
    def sense(self) -> int:
        """−1 where the face was turned about the vertical: the unit then turns against the stage."""
        return -1 if self.axis.startswith("-") else 1

    @property
    def asked(self) -> Mount:
        """As a run's progress says it."""
        return Mount(mount_deg=self.deg, mount_axis=self.axis)

    def felt_at(self, stage_deg: float) -> float:
        """The angle about its axis that a unit reads which is clamped so."""
        return self.sense * (stage_deg + self.deg)

    def clamped_at(self, stage_deg: float, angle_deg: float) -> float:
        """The angle at which a unit is clamped that stands so about its axis, on the mount's turn."""
        return self.deg + wrap_deg(self.sense * angle_deg - stage_deg - self.deg)

    def refusal(self, stage_deg: float, angle_deg: float, accel_g: FloatArray) -> str | None:
        """Why the unit is not clamped so; None where it is, within `MOST_OFF_DEG`.

        `angle_deg` is about the unit's axis; `accel_g` (3,) is NaN where the board does not send it.
        """
        name = self.axis[-1]
        along_g = float(accel_g[AXES.index(name)])
        if abs(along_g) > MOST_ALONG_G:
            return (
                f"gravity says that the unit's {name} does not lie along the stage's axis "
                f"({along_g:+.2f} g along it): clamp it with its {self.axis} along the axis"
            )
        left_deg = self.deg - self.clamped_at(stage_deg, angle_deg)
        if abs(left_deg) <= MOST_OFF_DEG:
            return None
        way = "by a further" if left_deg > 0 else "back by"
        return (
            f"the unit is clamped at {self.deg - left_deg:.1f}°, not {self.deg:g}°: "
            f"turn it {way} {abs(left_deg):.1f}°"
        )


def angle_about_deg(axis: MountAxis, accel_g: FloatArray) -> float:
    """The angle about one of the unit's axes of a specific force (3,)."""
    return float(elevation_deg(along_axis(accel_g[None, :], axis))[0])
