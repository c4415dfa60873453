"""Coming back to a rig after an interruption: the last pose once more, from the side it was approached."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from calrig.analysis.errors import NotTheSame
from calrig.calibration.pose import Pose
from calrig.estimation.angles import wrap_deg
from calrig.estimation.reading import Reading

MOVE_OFF_DEG = 5.0
"""More than any play."""
CHANCE_STD = 6.0
REMOUNTED_DEG = 0.5
"""More than a unit turns by itself: 19 °C of warm-up turn an MPU-6050 by 0.28° (the measured warm-up log)."""


def way_back(last: Pose, limits_deg: tuple[float, float]) -> list[float]:
    """Elevations to go to, in order, so as to stand at a pose as it was approached."""
    low, high = limits_deg
    beside_deg = min(max(last.target_deg - MOVE_OFF_DEG * (last.approach or 0), low), high)
    return [beside_deg, last.target_deg] if beside_deg != last.target_deg else [last.target_deg]


@dataclass(frozen=True, slots=True)
class Returned:
    """The last pose before an interruption, and its reading afterwards."""

    before: Pose
    after: Reading

    @property
    def difference_deg(self) -> float:
        """How much more the unit reads than before."""
        return wrap_deg(self.after.reading_deg - self.before.reading_deg)

    @property
    def std_deg(self) -> float | None:
        """What the difference may be by chance; None where a standard error is not known."""
        errors = (self.before.reading_stderr_deg, self.after.reading_stderr_deg)
        return None if None in errors else math.hypot(*(error or 0.0 for error in errors))

    def require_same_unit(self) -> None:
        """Raises NotTheSame where the unit must have been touched meanwhile."""
        if abs(self.difference_deg) > max(REMOUNTED_DEG, CHANCE_STD * (self.std_deg or 0.0)):
            raise NotTheSame(
                f"at {self.before.target_deg:g}° the unit reads {self.difference_deg:+.3f}° more than before "
                "the interruption: it, its mount or the stage's zero was moved, or it is another unit; start "
                "a new run"
            )

    def document(self) -> dict[str, Any]:
        """As it is kept with the run."""
        return {
            "target_deg": self.before.target_deg,
            "before_deg": self.before.reading_deg,
            "after_deg": self.after.reading_deg,
            "difference_deg": self.difference_deg,
            "difference_std_deg": self.std_deg,
        }

    def warnings(self) -> list[str]:
        """What a person should know of it."""
        if self.std_deg is None or abs(self.difference_deg) <= CHANCE_STD * self.std_deg:
            return []
        return [
            f"at {self.before.target_deg:g}° the unit reads {self.difference_deg:+.3f}° more than before the "
            f"interruption, and chance allows {CHANCE_STD * self.std_deg:.3f}°: the diagnosis tells whether "
            "it drifted or slipped"
        ]
