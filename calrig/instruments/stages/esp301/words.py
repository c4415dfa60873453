"""What an ESP301 says in codes, in words (ESP301 user's manual, appendix A)."""

from __future__ import annotations

BAUDRATE = 19200

ERRORS = {
    1: "PCI communication time-out",
    4: "emergency stop",
    6: "unknown command",
    7: "parameter out of range",
    8: "cable interlock open",
    9: "axis number out of range",
    37: "axis number missing",
    38: "parameter missing",
    40: "the last command cannot be repeated",
}

AXIS_ERRORS = {
    0: "motor type not defined",
    1: "parameter out of range",
    2: "amplifier fault",
    3: "following error: the stage was blocked, or the motor lost power",
    4: "positive limit reached, or the target lies beyond it",
    5: "negative limit reached, or the target lies beyond it",
    6: "positive software limit reached, or the target lies beyond it",
    7: "negative software limit reached, or the target lies beyond it",
    8: "motor or stage not connected",
    9: "feedback signal fault: check the encoder's cable",
    10: "maximum velocity exceeded",
    11: "maximum acceleration exceeded",
    13: "motor not enabled",
    15: "maximum jerk exceeded",
    16: "maximum DAC offset exceeded",
    17: "critical settings are protected",
    18: "stage device error",
    19: "stage data invalid",
    20: "homing aborted",
    21: "motor current not defined",
    22: "drive communication error",
    23: "drive not detected",
    24: "speed out of range",
    26: "parameter change not allowed",
    27: "invalid trajectory mode for homing",
    28: "invalid encoder step ratio",
    29: "digital I/O interlock",
    30: "not allowed during homing",
    31: "not allowed in a group",
    32: "invalid trajectory mode for moving",
}


def error_words(code: int) -> str:
    """A code of `TE?` with what it means; an axis's own is 100 times the axis and a number."""
    known = AXIS_ERRORS.get(code % 100) if code >= 100 else ERRORS.get(code)
    return f"{known or 'an error this driver does not know'} (error {code})"
