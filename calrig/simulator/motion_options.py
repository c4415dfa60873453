"""What moves the sensor of a simulated rig: its stage's mechanics, and how it is mounted on the table."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Vector = tuple[float, float, float]
NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
MountAxis = Literal["x", "y", "z", "-x", "-y", "-z"]
ZERO: Vector = (0.0, 0.0, 0.0)


class Options(BaseModel):
    """A part of a rig: no options but its own, and none changes."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StageHarmonic(Options):
    """amplitude·sin(order·φ + phase) at the table's angle φ."""

    order: int = Field(ge=1, le=1000)
    amplitude_deg: float = Field(ge=-5, le=5)
    phase_deg: float = 0.0


class MechanicsOptions(Options):
    """From the motor to the table. Angles are the stage's own, zero at its home.

    `encoder_on = "motor"` sees no fault of the gear; `"table"` sees worm and backlash, but neither its own
    eccentricity nor what bends beyond it.
    """

    power_up_deg: float = Field(default=4.0, ge=-170, le=170)
    homing_std_deg: NotNegative = 0.0
    scale_error_pct: float = Field(default=0.0, gt=-50, lt=50)
    backlash_deg: NotNegative = 0.0
    eccentricity_deg: float = Field(default=0.0, ge=-5, le=5)
    eccentricity_phase_deg: float = 0.0
    worm_deg: float = 0.0
    worm_period_deg: Positive = 7.2
    worm_phase_deg: float = 0.0
    harmonics: tuple[StageHarmonic, ...] = ()
    """Further errors of the table that close on a turn."""
    motor_step_deg: Positive = 1.8
    """Full step of the motor, at the table: step angle over the gear's ratio."""
    detent_share: float = Field(default=0.0, ge=0, le=0.2)
    """Torque of the motor's detents over its holding torque; a microstepped motor stands off by it."""
    vibration_g: NotNegative = 0.0
    """Amplitude at which the turning motor shakes the package, at its step frequency."""
    vibration_harmonics: tuple[float, ...] = Field(default=(1.0, 0.5, 0.25), min_length=1, max_length=8)
    """Of that, the shares at once, twice, … the step frequency."""
    vibration_direction: Vector = (0.2, 0.7, 0.7)
    """On the table: along the stage's axis, tangential, radial; of any length but 0."""
    vibration_resonance_hz: Positive | None = None
    """What is shaken hangs in a spring: below this it hardly moves, near it ten times as much."""
    following_lag_s: NotNegative = 0.0
    following_std_deg: NotNegative = 0.0
    creep_fraction: float = Field(default=0.0, ge=0, lt=1)
    creep_s: Positive = 1.5
    encoder_on: Literal["motor", "table"] = "motor"
    encoder_resolution_deg: NotNegative = 0.0
    obstruction_deg: float | None = None
    """A motor angle that the stage cannot pass: it stalls there."""

    @model_validator(mode="after")
    def _worm_never_runs_backwards(self) -> Self:
        if abs(self.worm_deg) * 2 * 3.1416 > 0.5 * self.worm_period_deg:
            raise ValueError("worm_deg is so large for its worm_period_deg that the table would turn back")
        return self

    @model_validator(mode="after")
    def _vibration_has_a_direction(self) -> Self:
        if not any(self.vibration_direction):
            raise ValueError("vibration_direction is 0, 0, 0")
        return self

    @model_validator(mode="after")
    def _table_never_runs_backwards(self) -> Self:
        if sum(abs(wave.amplitude_deg) * wave.order for wave in self.harmonics) * 3.1416 / 180 > 0.5:
            raise ValueError("the harmonics are so large that the table would turn back")
        return self


class MountOptions(Options):
    """From the table to the sensor's package: how it sits, slips and sags, and how level the axis is.

    A cable of mass `cable_mass_kg` hangs on an arm `cable_arm_m` that is horizontal at
    `cable_horizontal_deg`, and winds up with `cable_stiffness_nm_per_deg`; what its torque bends is
    `compliance_deg_per_nm`. Under the clamp's own load, from `creep_began_s` on, the joint gives way by
    `creep_deg_per_decade` in each tenfold of time.
    """

    offset_deg: float = 0.0
    """The base is turned about the stage's axis, whichever face is clamped."""
    roll_deg: float = Field(default=0.0, ge=-45, le=45)
    """The sensor is turned about x in its case, and comes along into every clamping, as yaw and pitch do."""
    yaw_deg: float = Field(default=0.0, ge=-45, le=45)
    pitch_deg: float = Field(default=0.0, ge=-45, le=45)
    axis_tilt_deg: float = Field(default=0.0, ge=-45, le=45)
    clamped_deg: float = Field(default=0.0, ge=-360, le=360)
    """The angle at which the unit sits in its clamp when the rig is switched on."""
    clamped_axis: MountAxis = "x"
    """Which of the unit's axes lies along the stage's then."""
    seat_std_deg: NotNegative = 0.0
    """How far each clamping is off, about each of three axes, drawn anew every time."""
    slip_deg: float = 0.0
    slip_at_s: NotNegative = 0.0
    slip_s: Positive = 0.05
    creep_deg_per_decade: float = 0.0
    creep_began_s: float = 0.0
    lever_arm_m: NotNegative = 0.0
    """How far from the stage's axis the sensor is, upward where the table stands at 0."""
    cable_mass_kg: NotNegative = 0.0
    cable_arm_m: NotNegative = 0.05
    cable_horizontal_deg: float = 0.0
    cable_stiffness_nm_per_deg: NotNegative = 0.0
    compliance_deg_per_nm: NotNegative = 0.0
