"""What GRBL keeps without power: settings, work offsets, startup lines, build information (settings.c)."""

from calrig.simulator.config import StageOptions
from calrig.simulator.stages.grbl.gcode import Refusal

LETTERS = "XYZABC"
STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
"""Settings of X; those of the other axes follow."""
IDLE_DELAY, REPORT, JUNCTION, INCHES, SOFT_LIMITS, HARD_LIMITS, HOMING = 1, 10, 11, 13, 20, 21, 22
HOMING_SIDE, LOCATE_RATE, SEEK_RATE, DEBOUNCE, PULL_OFF = 23, 24, 25, 26, 27
STEPS_PER_DEG = 200.0
"""Of the simulated motor and gear."""
DEFAULTS: dict[int, float] = {
    0: 10, IDLE_DELAY: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, REPORT: 1, JUNCTION: 0.01, 12: 0.002, INCHES: 0,
    SOFT_LIMITS: 0, HARD_LIMITS: 0, HOMING: 0, HOMING_SIDE: 0, LOCATE_RATE: 25, SEEK_RATE: 500,
    DEBOUNCE: 250, PULL_OFF: 1, 30: 1000, 31: 0, 32: 0,
}  # fmt: skip
"""Of the standard build, as `$RST=$` restores them."""
AXIS_DEFAULTS = {STEPS: 250.0, RATE: 500.0, ACCELERATION: 10.0, TRAVEL: 200.0}
WITH_DECIMALS = {JUNCTION, 12, LOCATE_RATE, SEEK_RATE, PULL_OFF}
IS_SWITCH = {4, 5, 6, INCHES, SOFT_LIMITS, HARD_LIMITS, HOMING, 32}
OF_1_1 = {30, 31, 32}
SPINDLE_SPEEDS = {30, 31}
SHORTEST_PULSE_US = 3
N_OFFSETS = 6
GO_HOME = (28, 30)


class Eeprom:
    """The memory of one controller.

    Attributes:
        values: settings by number, as `$$` lists them; rates in units per minute.
        offsets: work coordinate systems G54 to G59 (0 to 5) and the places of G28 and G30 (28, 30), in units.
        startup: the two lines that run at each start.
        build: text of `$I=`.
        is_blank: nothing was ever written; the first start finds that out.
    """

    def __init__(self, options: StageOptions, index: int, *, is_old: bool) -> None:
        self.n_axes = max(3, index + 1)
        self._is_old = is_old
        self.is_blank = options.blank_eeprom
        self.startup = ["", ""]
        self.build = ""
        self.offsets: dict[int, list[float]] = {}
        self.restore_offsets()
        self.values: dict[int, float] = {}
        self.restore_settings()
        if not options.blank_eeprom:
            self._set_up(options)

    def restore_settings(self) -> None:
        """Take the defaults of the build (`$RST=$`)."""
        self.values = {n: v for n, v in DEFAULTS.items() if not (self._is_old and n in OF_1_1)}
        if self._is_old:
            self.values[REPORT] = 3
        for first, value in AXIS_DEFAULTS.items():
            self.values |= {first + axis: value for axis in range(self.n_axes)}

    def restore_offsets(self) -> None:
        """Clear all work offsets (`$RST=#`)."""
        self.offsets = {place: [0.0] * self.n_axes for place in (*range(N_OFFSETS), *GO_HOME)}

    def restore_texts(self) -> None:
        """Clear startup lines and build information (`$RST=*`)."""
        self.startup, self.build = ["", ""], ""

    def flag(self, number: int) -> bool:
        """Whether a setting is on."""
        return bool(self.values[number])

    def homed(self, axis: int) -> float:
        """Machine coordinate of an axis after homing: a pull-off away from one end of the negative space."""
        pull_off = self.values[PULL_OFF]
        return pull_off - self.values[TRAVEL + axis] if self.homing_side(axis) < 0 else -pull_off

    def homing_side(self, axis: int) -> float:
        """The direction in which an axis looks for its switch: -1 or 1."""
        return -1.0 if int(self.values[HOMING_SIDE]) >> axis & 1 else 1.0

    @property
    def steps_per_unit(self) -> list[float]:
        """Of each axis."""
        return [self.values[STEPS + axis] for axis in range(self.n_axes)]

    def write(self, number: int, value: float) -> None:
        """Store a setting.

        Raises:
            Refusal: 3 no such setting, 4 negative, 6 step pulse too short, 10 soft limits without homing.
        """
        if value < 0:
            raise Refusal(4)
        if number not in self.values:
            raise Refusal(3)
        if number < STEPS and number not in WITH_DECIMALS:
            value = value if number in SPINDLE_SPEEDS else float(int(value) & 0xFF)
        if number in IS_SWITCH:
            value = float(value != 0)
        if number == 0 and value < SHORTEST_PULSE_US:
            raise Refusal(6)
        if number == SOFT_LIMITS and value and not self.flag(HOMING):
            raise Refusal(10)
        if number == HOMING and not value:
            self.values[SOFT_LIMITS] = 0.0
        self.values[number] = value

    def listing(self) -> list[tuple[int, str]]:
        """Numbers and values in the order of `$$`."""
        return [
            (n, f"{v:.3f}" if n in WITH_DECIMALS or n >= STEPS else f"{v:.0f}")
            for n, v in sorted(self.values.items())
        ]

    def _set_up(self, options: StageOptions) -> None:
        """Write the settings that the rig's builder has written."""
        low, high = options.limits_deg
        homing = float(options.homing)
        self.values |= {HARD_LIMITS: homing, HOMING: homing, HOMING_SIDE: (1 << self.n_axes) - 1}
        self.values[SEEK_RATE] = options.homing_velocity_dps * 60
        self.values[LOCATE_RATE] = min(200.0, self.values[SEEK_RATE])
        for first, value in {
            STEPS: STEPS_PER_DEG,
            RATE: options.velocity_dps * 60,
            ACCELERATION: options.acceleration_dps2,
            TRAVEL: high - low,
        }.items():
            self.values |= {first + axis: value for axis in range(self.n_axes)}
        self.values |= {number: value for number, value in options.settings.items() if number in self.values}
        index = min(options.axis, len(LETTERS)) - 1
        if options.g54_deg is not None:
            self.offsets[0][index] = options.g54_deg
        elif options.homing:
            self.offsets[0][index] = self.homed(index)
