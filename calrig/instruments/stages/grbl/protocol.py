"""Messages of GRBL 1.1: reports taken apart, alarms and errors in words (gnea/grbl, doc/csv)."""

import re
from dataclasses import dataclass

BAUDRATE = 115200

_NUMBERS = r"-?\d+\.\d+(?:,-?\d+\.\d+){0,5}"
_REPORT = re.compile(
    r"<(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep)(?::(\d))?"
    rf"\|([MW])Pos:({_NUMBERS})((?:\|[A-Za-z]+:[^|<>]*)*)>"
)
_OFFSET = re.compile(rf"\|WCO:({_NUMBERS})(?=\||$)")

_BEFORE_1_1 = re.compile(r"<(?:Idle|Run|Hold|Home|Alarm|Check|Door|Queue),[MW]Pos:-?\d+\.\d+,[^|<>]*>")

BANNER = re.compile(r"(Grbl \S+) \['\$' for help\]")
VERSION = re.compile(r"\[VER:([^:\]]+?)(\.\d{8})?:[^\]]*\]")
"""The answer to `$I`: its version, as the banner has it, and the day of its build."""
MODES = re.compile(r"\[GC:(G\d[^\[\]]*)\]")
"""The answer to `$G`: the words in force, G-codes first, then `M`, `T`, `F` and `S`."""
REPLY = re.compile(r"ok|error:(\d{1,3})")
ALARM = re.compile(r"ALARM:(\d{1,2})")
SETTING = re.compile(r"\$(\d{1,3})=(-?\d+(?:\.\d*)?)(?: .*)?")
REMARK = re.compile(r"\[[^\[\]]*\]|>.*:(?:ok|error:\d+)|\$N\d=.*")

SOFT_LIMIT = 2
LOCKED_UNTIL_RESET = (1, SOFT_LIMIT)
TAKES_RESET = "[MSG:Reset to continue]"
"""What follows on an alarm that locks, half a second later; a reset sent before is thrown away."""
NOT_1_1 = (
    "and not as GRBL 1.1, which alone calrig knows: put 1.1 on the controller and enter its $ settings again"
)
ALARMS = {
    1: "a limit switch was hit: GRBL has stopped the motor by itself; steps are likely lost; clear its way",
    2: "soft limit: the target lies beyond the travel",
    3: "it was reset while it moved, and steps are likely lost",
    4: "probe not in its initial state",
    5: "probe without contact",
    6: "it was reset during homing",
    7: "the safety door was opened during homing",
    8: "homing failed: the limit switch stayed closed after pulling off",
    9: "homing failed: no limit switch found",
}
ERRORS = {
    1: "a word without its letter",
    2: "a number it cannot read",
    3: "unknown $ command",
    4: "a negative value where none may be",
    5: "homing is not switched on ($22)",
    6: "step pulse below 3 µs",
    7: "its EEPROM could not be read, defaults are in force: check every $ setting",
    8: "not allowed unless it is idle",
    9: "locked out in alarm or jog",
    10: "soft limits need homing",
    11: "line too long",
    12: "step rate above what it can do",
    13: "safety door open",
    14: "line too long for its EEPROM",
    15: "jog target beyond the travel",
    16: "no such jog command",
    17: "laser mode needs PWM",
    20: "unsupported G-code",
    21: "two G-codes of one group",
    22: "no feed rate",
    23: "G-code needs a whole number",
    24: "two G-codes with axis words",
    25: "repeated word",
    26: "axis word missing: has it this axis?",
    27: "line number out of range",
    28: "value missing",
    29: "no such work coordinates",
    30: "G53 without G0 or G1",
    31: "axis words without use",
    32: "arc without axis words",
    33: "invalid target",
    34: "invalid radius",
    35: "arc without offsets",
    36: "unused words",
    37: "no such axis for tool length",
    38: "tool number too large",
}


@dataclass(frozen=True, slots=True)
class Report:
    """What `?` is answered with.

    Attributes:
        state: `Idle`, `Run`, `Hold`, `Jog`, `Alarm`, `Door`, `Check`, `Home` or `Sleep`.
        detail: the digit after it, as in `Hold:0`, or "".
        machine: whether `position` is in machine (MPos) or in work coordinates (WPos, `$10`).
        position: one number an axis, in the controller's units.
        offset: work coordinate offset (WCO), sent now and then; None where it is not.
    """

    state: str
    detail: str
    machine: bool
    position: tuple[float, ...]
    offset: tuple[float, ...] | None

    @property
    def moves(self) -> bool:
        """Whether the stage may be turning: a hold or an open door brakes first, and a door may park."""
        held = self.state in ("Hold", "Door") and self.detail not in ("", "0")
        return self.state in ("Run", "Jog", "Home") or (held and (self.state, self.detail) != ("Door", "1"))


def parse_report(line: str) -> Report | None:
    """The report that a line is, or None where any part of it is not as it should be."""
    whole = _REPORT.fullmatch(line)
    if whole is None:
        return None
    state, detail, frame, position, fields = whole.groups()
    offset = _OFFSET.search(fields)
    if offset is None and "WCO" in fields:
        return None
    work = _floats(offset[1]) if offset else None
    return Report(state, detail or "", frame == "M", _floats(position), work)


def is_report_before_1_1(line: str) -> bool:
    """Whether a line is a status report as GRBL 0.9 and older write it: commas where 1.1 has bars."""
    return _BEFORE_1_1.fullmatch(line) is not None


def alarm_words(number: int) -> str:
    """`ALARM:n` with what it means."""
    return f"ALARM:{number}, {ALARMS.get(number, 'an alarm this driver does not know')}"


def error_words(reply: str) -> str:
    """`error:n` with what it means."""
    number = int(reply.removeprefix("error:"))
    return f"{ERRORS.get(number, 'an error this driver does not know')} ({reply})"


def _floats(text: str) -> tuple[float, ...]:
    return tuple(float(number) for number in text.split(","))
