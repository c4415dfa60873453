"""How the unit is clamped on its stage, by gravity: what a run asks a person for between its parts."""

from __future__ import annotations

from dataclasses import dataclass

from calrig.estimation.angles import AXES, along_axis, elevation_deg, wrap_deg
from calrig.instruments.types import FloatArray
from calrig.plan import MountAxis
from calrig.store.records import WaitingFor

MOST_OFF_DEG = 5.0
"""CONTRACT section 2. A hand clamps to a degree; offsets of 80 mg turn a unit's gravity by 4.6°."""
MOST_ALONG_G = 0.5
"""An axis that lies along a level stage's feels nothing of gravity; leaning by 30° it feels this much."""


@dataclass(frozen=True, slots=True)
class Mount:
    """The angle at which a unit is to be clamped, and which of its axes lies along the stage's."""

    deg: float
    axis: MountAxis = "x"

    @property
    def sense(self) -> int:
        """−1 where the face was turned about the vertical: the unit then turns against the stage."""
        return -1 if self.axis.startswith("-") else 1

    @property
    def asked(self) -> WaitingFor:
        """As a run's progress says it."""
        return {"mount_deg": self.deg, "mount_axis": self.axis}

    def felt_at(self, stage_deg: float) -> float:
        """The angle about its axis that a unit reads which is clamped so."""
        return self.sense * (stage_deg + self.deg)

    def refusal(self, stage_deg: float, angle_deg: float, accel_g: FloatArray) -> str | None:
        """Why the unit is not clamped so; None where it is, within `MOST_OFF_DEG`.

        Args:
            stage_deg: where the stage stands.
            angle_deg: about the unit's axis, by its accelerometer, or as its board says.
            accel_g: (3,) specific force, NaN where the board does not send it.
        """
        name = self.axis[-1]
        along_g = float(accel_g[AXES.index(name)])
        if abs(along_g) > MOST_ALONG_G:
            return (
                f"gravity says that the unit's {name} does not lie along the stage's axis "
                f"({along_g:+.2f} g along it): clamp it with its {self.axis} along the axis"
            )
        left_deg = wrap_deg(self.felt_at(stage_deg) - angle_deg) * self.sense
        if abs(left_deg) <= MOST_OFF_DEG:
            return None
        way = "on" if left_deg > 0 else "back"
        return (
            f"the unit is turned by {self.deg - left_deg:.1f}°, not {self.deg:g}°: "
            f"turn it {way} by {abs(left_deg):.1f}°"
        )


def angle_about_deg(axis: MountAxis, accel_g: FloatArray) -> float:
    """The angle about one of the unit's axes of a specific force (3,)."""
    return float(elevation_deg(along_axis(accel_g[None, :], axis))[0])
