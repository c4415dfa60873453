"""What an axis was sent to do, and how long that may take."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(slots=True)
class Goal:
    """What the axis was sent to do: a target, or None for the reference; and what it must not overstep."""

    target_deg: float | None
    deadline_s: float
    stall_s: float
    progress_s: float
    progress_deg: float
    from_deg: float = 0.0
    off_since_s: float | None = None

    @property
    def words(self) -> str:
        """What it is about, as it is said in an error."""
        return "homing" if self.target_deg is None else f"the move to {self.target_deg:g}°"

    def is_astray(self, elevation_deg: float, slack_deg: float) -> bool:
        """Whether this is off the way from where the axis was to its target, by more than `slack_deg`."""
        if self.target_deg is None:
            return False
        low, high = sorted((self.from_deg, self.target_deg))
        return not low - slack_deg <= elevation_deg <= high + slack_deg


def travel_time_s(distance_deg: float, velocity_dps: float, acceleration_dps2: float) -> float:
    """The time of a move with trapezoidal velocity, triangular where it is too short to reach the plateau."""
    if distance_deg * acceleration_dps2 < velocity_dps**2:
        return 2 * math.sqrt(distance_deg / acceleration_dps2)
    return distance_deg / velocity_dps + velocity_dps / acceleration_dps2
