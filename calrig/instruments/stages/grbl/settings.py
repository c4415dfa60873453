"""Settings of a GRBL 1.1 controller (`$$`): what they allow, what they rule out, what they put in doubt.

The numbers are those of GRBL v1.1 Configuration, "Grbl Settings": `$1` ms until the motors are switched off
after a move (255: never), `$13` reports in inches, `$20` soft limits, `$22` homing, and for X, Y, Z in turn
`$100` steps per unit, `$110` maximum rate in units a minute, `$120` acceleration, `$130` travel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from calrig.instruments.errors import StageError

if TYPE_CHECKING:  # a scan knows the warnings without a port
    from calrig.instruments.stages.grbl.link import GrblLink

MOTORS_OFF, INCHES, SOFT_LIMITS, HOMING = 1, 13, 20, 22
STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130  # of X; the other axes follow
ALWAYS_POWERED = 255
FASTEST_STEPS_HZ = 30_000
"""GRBL v1.1 on an ATmega328P: README, "up to 30kHz of stable, jitter free control pulses"."""
COARSE_STEP_DEG = 0.05
FACTORY = {STEPS: 250.0, RATE: 500.0, ACCELERATION: 10.0}
"""defaults.h, DEFAULTS_GENERIC: what a new controller has, and one whose EEPROM was lost (error:7)."""


@dataclass(frozen=True)
class ControllerSettings:
    """The settings of one axis; one unit is a degree. A setting that the controller does not list is None."""

    values: Mapping[int, float]
    index: int

    @classmethod
    def read(cls, link: GrblLink, index: int) -> Self | None:
        """Reads the settings until two listings agree; None if they never do."""
        values = link.settings_twice(SOFT_LIMITS, HOMING, RATE + index)
        return cls(values, index) if values else None

    def require_usable(self, name: str) -> None:
        """Raise StageError with what to set, where no pose can be taken with these settings."""
        if self.values.get(INCHES):
            raise StageError(f"{name} reports in inches: set $13=0, so that a unit is a degree")
        for number, what in ((STEPS, "steps per degree"), (RATE, "°/min"), (ACCELERATION, "°/s²")):
            value = self.values.get(number + self.index)
            if value is not None and value <= 0:
                setting = f"${number + self.index}"
                raise StageError(f"{name} cannot move with {setting}={value:g}: set {setting} to its {what}")

    @property
    def homes(self) -> bool:
        """Whether `$H` looks for a limit switch."""
        return bool(self.values.get(HOMING))

    @property
    def velocity_dps(self) -> float | None:
        """Highest velocity."""
        rate_per_min = self.values.get(RATE + self.index)
        return None if rate_per_min is None else rate_per_min / 60

    @property
    def acceleration_dps2(self) -> float | None:
        """Acceleration of every move."""
        return self.values.get(ACCELERATION + self.index)

    @property
    def step_deg(self) -> float:
        """The angle of one step; 0 where the controller does not list it."""
        steps = self.values.get(STEPS + self.index)
        return 1 / steps if steps else 0.0

    @property
    def travel_deg(self) -> float | None:
        """Travel from the machine's origin; None where soft limits are off."""
        return self.values.get(TRAVEL + self.index) if self.values.get(SOFT_LIMITS) else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What these settings put in doubt, a sentence each, with what to set."""
        axis, said = self.index, []
        own = {number: self.values.get(number + axis) for number in FACTORY}
        if own == FACTORY:
            said.append(
                f"${STEPS + axis}, ${RATE + axis} and ${ACCELERATION + axis} are GRBL's factory settings: "
                f"set ${STEPS + axis} to the steps per degree of this stage."
            )
        if self.step_deg > COARSE_STEP_DEG:
            said.append(
                f"One step is {self.step_deg:.3g}° (${STEPS + axis}): poses are that far apart at least; "
                "use finer microsteps or a gear."
            )
        if (rate_hz := (own[STEPS] or 0) * (own[RATE] or 0) / 60) > FASTEST_STEPS_HZ:
            said.append(
                f"${RATE + axis} asks for {rate_hz / 1000:.0f} kHz of steps and GRBL makes at most "
                f"{FASTEST_STEPS_HZ / 1000:.0f} kHz: set ${RATE + axis} lower."
            )
        return general_warnings(self.values) + tuple(said)


def general_warnings(values: Mapping[int, float]) -> tuple[str, ...]:
    """The warnings that concern all axes."""
    said = []
    off_after_ms = values.get(MOTORS_OFF, ALWAYS_POWERED)
    if off_after_ms != ALWAYS_POWERED:
        said.append(
            f"$1={off_after_ms:g} switches the motors off {off_after_ms:g} ms after each move, so that the "
            "table may sag in every dwell: set $1=255."
        )
    if values.get(HOMING) == 0:
        said.append(
            "$22=0: the stage has no homing, so its angle is the one that was stated, less what was lost "
            "unseen while it was off: fit a limit switch and set $22=1 to be sure."
        )
    elif values.get(SOFT_LIMITS) == 0:
        said.append("$20=0: the controller does not refuse targets beyond its travel: set $20=1 and $130.")
    return tuple(said)
