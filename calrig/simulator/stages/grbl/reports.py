"""What GRBL says, in its two generations: 1.1 in bars and numbers, 0.9 in commas and words (report.c)."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from calrig.simulator.stages.grbl.eeprom import INCHES, LETTERS, REPORT, Eeprom
from calrig.simulator.stages.grbl.gcode import MM_PER_INCH, ParserState

HARD_LIMIT, SOFT_LIMIT, RESET_IN_MOTION, RESET_IN_HOMING, DOOR_IN_HOMING, SWITCH_STAYS, NO_SWITCH = (
    1, 2, 3, 6, 7, 8, 9,
)  # fmt: skip
BUILDS = {"0.9": "20160726", "1.1": "20190830"}
_OLD_ALARMS = {
    HARD_LIMIT: "Hard limit",
    SOFT_LIMIT: "Soft limit",
    RESET_IN_MOTION: "Abort during cycle",
}
_OLD_ERRORS = {
    1: "Expected command letter",
    2: "Bad number format",
    3: "Invalid statement",
    4: "Value < 0",
    5: "Setting disabled",
    6: "Value < 3 usec",
    7: "EEPROM read fail. Using defaults",
    8: "Not idle",
    9: "Alarm lock",
    10: "Homing not enabled",
    11: "Line overflow",
    20: "Unsupported command",
    21: "Modal group violation",
    22: "Undefined feed rate",
}
_OLD_HELP = (
    "$$ (view Grbl settings)", "$# (view # parameters)", "$G (view parser state)", "$I (view build info)",
    "$N (view startup blocks)", "$x=value (save Grbl setting)", "$Nx=line (save startup block)",
    "$C (check gcode mode)", "$X (kill alarm lock)", "$H (run homing cycle)", "~ (cycle start)",
    "! (feed hold)", "? (current status)", "ctrl-x (reset Grbl)",
)  # fmt: skip
_HELP = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"
_OLD_SETTINGS = {
    0: "step pulse, usec", 1: "step idle delay, msec", 2: "step port invert mask:{mask}",
    3: "dir port invert mask:{mask}", 4: "step enable invert, bool", 5: "limit pins invert, bool",
    6: "probe pin invert, bool", 10: "status report mask:{mask}", 11: "junction deviation, mm",
    12: "arc tolerance, mm", 13: "report inches, bool", 20: "soft limits, bool", 21: "hard limits, bool",
    22: "homing cycle, bool", 23: "homing dir invert mask:{mask}", 24: "homing feed, mm/min",
    25: "homing seek, mm/min", 26: "homing debounce, msec", 27: "homing pull-off, mm",
}  # fmt: skip
_OLD_AXIS_SETTINGS = {10: ", step/mm", 11: " max rate, mm/min", 12: " accel, mm/sec^2", 13: " max travel, mm"}
WCO_IDLE, WCO_BUSY, OV_IDLE, OV_BUSY = 10, 30, 10, 20
"""Every so many reports tell the work offset and the overrides, standing and moving."""


class State(StrEnum):
    """The states of the controller, as a report names them."""

    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    JOG = "Jog"
    HOME = "Home"
    ALARM = "Alarm"
    CHECK = "Check"
    DOOR = "Door"
    SLEEP = "Sleep"


BUSY = {State.HOME, State.RUN, State.HOLD, State.JOG, State.DOOR}


@dataclass
class Counters:
    """Reports until the next one with the work offset, and with the overrides."""

    offset: int = 0
    overrides: int = 0


@dataclass
class Status:
    """What one status report tells. Places in units, rate in units per minute."""

    state: State
    substate: int | None
    machine: Sequence[float]
    offset: Sequence[float]
    rate: float
    spindle: float
    room: int
    receive_room: int
    closed: str
    overrides: tuple[int, int, int]
    accessories: str


class Words:
    """What one version says: `version` as its banner has it."""

    def __init__(self, version: str, eeprom: Eeprom) -> None:
        self.version = version
        self.is_old = version.startswith("0.")
        self._eeprom = eeprom

    @property
    def banner(self) -> str:
        """What it says when it begins."""
        return f"Grbl {self.version} ['$' for help]"

    def status(self, status: Status, counters: Counters) -> str:
        """The answer to `?`; counts down to the next report with more in it."""
        mask = int(self._eeprom.values[REPORT])
        work = [place - zero for place, zero in zip(status.machine, status.offset, strict=True)]
        if self.is_old:
            return self._old_status(status, mask, work)
        state = status.state if status.substate is None else f"{status.state}:{status.substate}"
        fields = [state, f"MPos:{self._places(status.machine)}" if mask & 1 else f"WPos:{self._places(work)}"]
        if mask & 2:
            fields.append(f"Bf:{status.room},{status.receive_room}")
        fields.append(f"FS:{self._rate(status.rate)},{status.spindle:.0f}")
        if status.closed:
            fields.append(f"Pn:{status.closed}")
        is_busy = status.state in BUSY
        if counters.offset:
            counters.offset -= 1
        else:
            counters.offset = (WCO_BUSY if is_busy else WCO_IDLE) - 1
            counters.overrides = counters.overrides or 1
            fields.append(f"WCO:{self._places(status.offset)}")
        if counters.overrides:
            counters.overrides -= 1
        else:
            counters.overrides = (OV_BUSY if is_busy else OV_IDLE) - 1
            fields.append("Ov:{},{},{}".format(*status.overrides))
            if status.accessories:
                fields.append(f"A:{status.accessories}")
        return f"<{'|'.join(fields)}>"

    def settings(self) -> list[str]:
        """The answer to `$$`."""
        return [f"${n}={value}{self._remark_on(n, value)}" for n, value in self._eeprom.listing()]

    def build(self) -> list[str]:
        """The answer to `$I`."""
        build = f"{self.version}.{BUILDS['0.9' if self.is_old else '1.1']}:{self._eeprom.build}"
        return [f"[{build}]"] if self.is_old else [f"[VER:{build}]", "[OPT:V,15,128]"]

    def help(self) -> Sequence[str]:
        """The answer to `$`."""
        return _OLD_HELP if self.is_old else (_HELP,)

    def modes(self, state: ParserState) -> str:
        """The answer to `$G`."""
        modal = state.modal
        numbers = [modal.motion, modal.system, modal.plane, modal.units, modal.distance, modal.feed]
        words = " ".join(f"G{number}" for number in numbers)
        feed = self._rate(state.feed)
        if self.is_old:  # its tool number lasts no line
            return f"[{words} M0 M{modal.spindle} M{modal.coolant} T0 F{feed}. S{state.speed:.0f}.]"
        spindle = f"M{modal.spindle} M{modal.coolant} T{state.tool} F{feed} S{state.speed:.0f}"
        return f"[GC:{words} {spindle}]"

    def parameters(self, state: ParserState) -> list[str]:
        """The answer to `$#`."""
        places = {f"G{54 + k}": self._eeprom.offsets[k] for k in range(6)}
        places |= {f"G{k}": self._eeprom.offsets[k] for k in (28, 30)}
        places["G92"] = state.g92
        lines = [f"[{name}:{self._places(place)}]" for name, place in places.items()]
        nowhere = self._places([0.0] * self._eeprom.n_axes)
        return [*lines, f"[TLO:{self._places([state.tlo])}]", f"[PRB:{nowhere}:0]"]

    def alarm(self, number: int) -> str:
        """An alarm."""
        if self.is_old:
            return f"ALARM: {_OLD_ALARMS.get(number, 'Homing fail')}"
        return f"ALARM:{number}"

    def error(self, number: int) -> str:
        """What answers a line that is refused."""
        if self.is_old:
            return f"error: {_OLD_ERRORS.get(number, f'Invalid gcode ID:{number}')}"
        return f"error:{number}"

    def remark(self, text: str) -> str:
        """Return an unsolicited message."""
        return f"[{text}]" if self.is_old else f"[MSG:{text}]"

    def _old_status(self, status: Status, mask: int, work: Sequence[float]) -> str:
        fields = [str(status.state)]
        if mask & 1:
            fields.append(f"MPos:{self._places(status.machine)}")
        if mask & 2:
            fields.append(f"WPos:{self._places(work)}")
        return f"<{','.join(fields)}>"

    def _places(self, places: Sequence[float]) -> str:
        if self._eeprom.flag(INCHES):
            return ",".join(f"{place / MM_PER_INCH + 0.0:.4f}" for place in places)
        return ",".join(f"{place + 0.0:.3f}" for place in places)

    def _rate(self, rate: float) -> str:
        return f"{rate / MM_PER_INCH:.1f}" if self._eeprom.flag(INCHES) else f"{rate:.0f}"

    def _remark_on(self, number: int, value: str) -> str:
        if not self.is_old:
            return ""
        if number in _OLD_SETTINGS:
            return f" ({_OLD_SETTINGS[number].format(mask=format(int(float(value)), '08b'))})"
        return f" ({LETTERS[number % 10].lower()}{_OLD_AXIS_SETTINGS[number // 10]})"
