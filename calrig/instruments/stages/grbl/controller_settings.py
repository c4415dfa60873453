"""What a GRBL 1.1 controller is set to (`$$`), of one of its axes, in degrees and seconds.

The numbers are those of GRBL v1.1 Configuration, "Grbl Settings": `$13` reports in inches, `$20` soft limits,
`$22` homing, `$110`–`$112` maximum rate in units a minute, `$120`–`$122` acceleration, `$130`–`$132` travel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from calrig.instruments.stages.grbl.wire import GrblWire

INCHES, SOFT_LIMITS, HOMING = 13, 20, 22
RATE, ACCELERATION, TRAVEL = 110, 120, 130  # of X; the other axes follow


@dataclass(frozen=True)
class ControllerSettings:
    """One unit a degree; what a controller does not list is None."""

    values: dict[int, float]
    index: int

    @classmethod
    def read(cls, wire: GrblWire, index: int) -> Self | None:
        """Asks for them, twice alike each; None where they did not come."""
        values = wire.settings_twice(SOFT_LIMITS, HOMING, RATE + index)
        return cls(values, index) if values else None

    @property
    def in_inches(self) -> bool:
        """Whether it reports in inches."""
        return bool(self.values.get(INCHES))

    @property
    def homes(self) -> bool:
        """Whether it looks for a limit switch on `$H`."""
        return bool(self.values.get(HOMING))

    @property
    def velocity_dps(self) -> float | None:
        """The most."""
        rate_per_min = self.values.get(RATE + self.index)
        return None if rate_per_min is None else rate_per_min / 60

    @property
    def acceleration_dps2(self) -> float | None:
        """Of every move."""
        return self.values.get(ACCELERATION + self.index)

    @property
    def travel_deg(self) -> float | None:
        """How far from its origin it goes; None where soft limits are off."""
        return self.values.get(TRAVEL + self.index) if self.values.get(SOFT_LIMITS) else None
