"""What a simulated rig is made of: every part of its physics off unless it is asked for, and a seed."""

import difflib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from calrig.simulator.dialects import STAGES
from calrig.simulator.sketches import SKETCHES

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
    def _is_possible(self) -> Self:
        if abs(self.worm_deg) * 2 * 3.1416 > 0.5 * self.worm_period_deg:
            raise ValueError("worm_deg is so large for its worm_period_deg that the table would turn back")
        if not any(self.vibration_direction):
            raise ValueError("vibration_direction is 0, 0, 0")
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
    """How far each clamping is off, about each of three axes, drawn for each clamping."""
    slip_deg: float = 0.0
    slip_at_s: NotNegative = 0.0
    slip_s: Positive = 0.05
    creep_deg_per_decade: float = 0.0
    creep_began_s: float = 0.0
    lever_arm_m: NotNegative = 0.0
    """How far from the stage's axis the sensor is, upward with the table at 0."""
    cable_mass_kg: NotNegative = 0.0
    cable_arm_m: NotNegative = 0.05
    cable_horizontal_deg: float = 0.0
    cable_stiffness_nm_per_deg: NotNegative = 0.0
    compliance_deg_per_nm: NotNegative = 0.0


PRESETS: dict[str, dict[str, Any]] = {
    "ideal": {"imu": {"accel_noise_ug_per_rthz": 0.0, "gyro_noise_dps_per_rthz": 0.0}},
    # A stage of the 0.5° class and an ordinary breakout board: mount offset and gyro bias are what a
    # calibration expects; backlash, eccentricity, offset and temperature are unknown to it.
    "demo": {
        "seed": 1,
        "time_scale": 6.0,
        "stage": {"velocity_dps": 30.0, "acceleration_dps2": 90.0, "homing_velocity_dps": 15.0},
        "mechanics": {
            "backlash_deg": 0.12,
            "eccentricity_deg": 0.12,
            "eccentricity_phase_deg": 70.0,
            "encoder_resolution_deg": 0.001,
        },
        "mount": {"offset_deg": 0.8},
        "clamp": {},
        "environment": {
            "start_c": 24.0,
            "end_c": 38.0,
            "warm_up_s": 600.0,
            "ambient_amplitude_c": 1.5,
            "ambient_period_s": 900.0,
        },
        "imu": {
            "accel_bias_mg": [4.0, -2.0, 3.0],
            "accel_bias_mg_per_c": [0.0, 0.25, 0.0],
            "gyro_bias_dps": [1.4, -0.6, 0.3],
            "gyro_bias_dps_per_c": [0.01, 0.0, 0.0],
            "gyro_scale_error_pct": [0.8, 0.0, 0.0],
            "gyro_walk_dps_per_rts": 0.0005,
            "temperature_noise_c": 0.02,
        },
    },
}


StageFault = Literal["hang", "garbage", "echo"]
BoardFault = Literal[
    "silent", "garbage", "corrupt", "gaps", "frozen", "zeros", "clone", "half_lines", "reset"
]
NOT_OF_PACKETS = {"zeros", "clone", "half_lines", "reset"}
NOT_OF_TEXT = {"corrupt", "gaps"}

Pair = Literal["xy", "xz", "yx", "yz", "zx", "zy"]


def _one_of(names: Sequence[str]) -> AfterValidator:
    def known(name: str) -> str:
        if name not in names:
            raise ValueError(f"{name!r} is unknown; there are {', '.join(names)}")
        return name

    return AfterValidator(known)


class StageOptions(Options):
    """The stage's controller. `fault` makes it hang, answer garbage, or echo what it hears.

    `driver` is the dialect it speaks, `firmware` what it calls itself (without: the dialect's own). Of a GRBL
    alone: `homing` is whether it has limit switches and homes to them ($21, $22).
    """

    driver: Annotated[str, _one_of(STAGES)] = "smc100"
    axis: int = Field(default=1, ge=1, le=31)
    firmware: str | None = None
    homing: bool = True
    switch_deg: float | None = -1.0
    """Where the switch closes that a GRBL homes to, a pull-off ($27) below home; None: none ever closes."""
    settings: dict[int, float] = Field(default_factory=dict)
    """What `$n=` has stored in a GRBL, over what its other options make of it: `{20: 1}` for soft limits."""
    g54_deg: float | None = None
    """Machine coordinate of a GRBL's stored work zero; None: its position after homing."""
    blank_eeprom: bool = False
    """Nothing was ever stored in a GRBL: it takes its build's defaults and says so."""
    velocity_dps: Positive = 20.0
    acceleration_dps2: Positive = 80.0
    homing_velocity_dps: Positive = 10.0
    limits_deg: tuple[Annotated[float, Field(le=0)], NotNegative] = (-175.0, 175.0)
    report_delay_s: NotNegative = 0.0
    """How old an angle is when the controller says it; whether it turns, it says at once."""
    boot_s: NotNegative = 0.0
    """How long the boot loader of a GRBL's Arduino listens after a reset, before its firmware begins."""
    fault: StageFault | None = None


class EnvironmentOptions(Options):
    """Die temperature and supply voltage over simulated time."""

    start_c: float = Field(default=25.0, ge=-40, le=85)
    end_c: float = Field(default=25.0, ge=-40, le=85)
    warm_up_s: Positive = 300.0
    ambient_amplitude_c: NotNegative = 0.0
    ambient_period_s: Positive = 3600.0
    hysteresis_c: NotNegative = 0.0
    """Width of the loop: what depends on temperature follows the die's only after half of this."""
    stress_lag_s: NotNegative = 0.0
    """R·C of the package: what depends on temperature follows heat that has to reach it first."""
    supply_v: Positive = 3.3
    supply_ripple_v: float = 0.0
    supply_period_s: Positive = 60.0
    supply_waveform: Literal["sine", "square"] = "sine"


class ImuOptions(Options):
    """An MPU-6050: noise densities, ranges and registers are its data sheet's (PS-MPU-6000A rev. 3.4)."""

    accel_range_g: Literal[2, 4, 8, 16] = 2
    gyro_range_dps: Literal[250, 500, 1000, 2000] = 250
    dlpf_cfg: int | None = Field(default=None, ge=0, le=6)
    """The digital low-pass filter of the register map (`low_pass`), on motion and vibration but not on noise;
    None for neither delay nor attenuation."""
    accel_noise_ug_per_rthz: NotNegative = 400.0
    gyro_noise_dps_per_rthz: NotNegative = 0.005
    temperature_noise_c: NotNegative = 0.0
    accel_bias_mg: Vector = ZERO
    accel_gain_error_pct: Vector = ZERO
    accel_cross_axis_deg: dict[Pair, float] = Field(default_factory=dict)
    """`{"yz": 0.2}`: y measures a_y + a_z·sin 0.2°, and so on for each pair."""
    accel_quadratic_mg_per_g2: Vector = ZERO
    accel_cubic_mg_per_g3: Vector = ZERO
    accel_bias_mg_per_c: Vector = ZERO
    accel_gain_pct_per_c: Vector = ZERO
    accel_bias_mg_per_v: Vector = ZERO
    accel_walk_mg_per_rts: NotNegative = 0.0
    gyro_bias_dps: Vector = ZERO
    gyro_scale_error_pct: Vector = ZERO
    gyro_cross_axis_deg: dict[Pair, float] = Field(default_factory=dict)
    """As the accelerometer's."""
    gyro_dps_per_g: tuple[Vector, Vector, Vector] = (ZERO, ZERO, ZERO)
    """Of each axis, what specific force along x, y, z adds."""
    gyro_bias_dps_per_c: Vector = ZERO
    gyro_walk_dps_per_rts: NotNegative = 0.0
    package_turn_deg_per_c: float = 0.0
    reference_c: float = 25.0


class BoardOptions(Options):
    """The board around the sensor. `fault` breaks it on purpose.

    `sketch` is the public sketch that it runs instead of calrig's own; it then tells no serial number and has
    one rate.
    """

    sketch: Annotated[str, _one_of(tuple(SKETCHES))] | None = None
    serial: str = Field(default="", max_length=64)
    firmware: str = "calrig simulated"
    max_rate_hz: int = Field(default=1000, ge=1, le=8000)
    default_rate_hz: int = Field(default=200, ge=1, le=8000)
    clock_error_ppm: float = Field(default=0.0, ge=-50_000, le=50_000)
    """How much too fast its resonator runs: its seconds are as much too short."""
    boot_s: NotNegative = 0.0
    """Opening its port resets it, as DTR does an Arduino, and so long it hears nothing; 0: it does not.

    Of calrig's own sketch, on a `tcp` port: opening a pseudo-terminal cannot be detected.
    """
    fault: BoardFault | None = None

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        if self.default_rate_hz > self.max_rate_hz:
            raise ValueError("default_rate_hz is above max_rate_hz")
        if self.boot_s and self.sketch is not None:
            raise ValueError(f"boot_s is none of a board that runs {self.sketch}")
        if self.fault in (NOT_OF_PACKETS if self.sketch is None else NOT_OF_TEXT):
            raise ValueError(f"fault {self.fault!r} is none of a board that runs {self.sketch or 'calrig'}")
        return self


class ClampOptions(Options):
    """A motorised dividing head that the unit is clamped in. `fault` makes it answer nothing."""

    firmware: str = "INDEX calrig simulated"
    fault: Literal["hang"] | None = None


class SimulatorSettings(Options):
    """One simulated rig. Without options: an MPU-6050 with its data sheet's noise on a perfect stage."""

    preset: str | None = None
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    time_scale: float = Field(default=1.0, gt=0, le=1000)
    ports: Literal["auto", "pty", "tcp"] = "auto"
    stage: StageOptions = StageOptions()
    mechanics: MechanicsOptions = MechanicsOptions()
    mount: MountOptions = MountOptions()
    environment: EnvironmentOptions = EnvironmentOptions()
    imu: ImuOptions = ImuOptions()
    board: BoardOptions = BoardOptions()
    clamp: ClampOptions | None = None
    """Without, the unit is turned in its clamp by hand."""

    @model_validator(mode="after")
    def _time_is_real_without_a_clock(self) -> Self:
        if self.board.sketch is not None and self.time_scale != 1:
            raise ValueError("a board whose sketch sends no clock runs in real time: time_scale must be 1")
        return self

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self:
        """The settings of a rig's `simulated` table, over those of its preset where it names one.

        `options` are for example `{"preset": "demo", "seed": 3, "mechanics": {"backlash_deg": 0.2}}`.

        Raises:
            ValueError: an unknown preset or option or a wrong value; the message names the key.
        """
        preset = options.get("preset")
        if preset is not None and preset not in list(PRESETS):
            raise ValueError(f"preset: {preset!r} is unknown; there are {', '.join(sorted(PRESETS))}")
        merged = _merged(PRESETS[preset], options) if preset is not None else dict(options)
        try:
            return cls.model_validate(merged)
        except ValidationError as error:
            raise ValueError(_first_problem(error)) from None


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = _merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged


def _model_at(path: Sequence[str | int]) -> type[BaseModel]:
    """The options that are at a place of the settings."""
    if not path:
        return SimulatorSettings
    if path[0] == "clamp":
        return ClampOptions
    return (
        StageHarmonic if "harmonics" in path else type(SimulatorSettings.model_fields[str(path[0])].default)
    )


def _first_problem(error: ValidationError) -> str:
    problem = error.errors()[0]
    path = [str(part) for part in problem["loc"]]
    where = ".".join(path) or "options"
    if problem["type"] != "extra_forbidden":
        return f"{where}: {problem['msg'].removeprefix('Value error, ')}"
    model = _model_at(problem["loc"][:-1])
    near = difflib.get_close_matches(path[-1], model.model_fields, n=1)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(model.model_fields)}"
    return f"{where}: no such option; {hint}"
