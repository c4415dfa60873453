"""What a Zaber controller flags, in words (Zaber ASCII protocol manual, warning flags)."""

from __future__ import annotations

BAUDRATE = 115200

UNREFERENCED = ("WR", "WH")
FLAGS = {
    "FF": "critical system error",
    "FN": "stage not supported",
    "FZ": "stage inactive",
    "FH": "emergency stop: driver off",
    "FV": "supply voltage out of range: driver off",
    "FO": "driver off",
    "FC": "inrush current too high",
    "FM": "motor too hot",
    "FD": "driver off: motor power was cut, or it overheated",
    "FQ": "encoder error",
    "FI": "encoder index error",
    "FA": "analog encoder out of step",
    "FR": "overdrive limit exceeded",
    "FS": "stalled and stopped",
    "FB": "stream out of bounds",
    "FP": "path deviation",
    "FE": "limit sensor error",
    "FT": "excessive twist",
    "WL": "unexpected limit switch",
    "WV": "supply voltage out of range",
    "WT": "controller hot",
    "WS": "stalled, and recovered",
    "WM": "turned by force while it stood",
    "WP": "invalid calibration",
    "WR": "no reference position",
    "WH": "not homed",
    "NC": "turned by its knob",
    "NI": "motion interrupted",
    "NJ": "joystick being set up",
}


def flag_words(flags: list[str]) -> str:
    """The flags with what they mean."""
    return ", ".join(f"{flag} {FLAGS.get(flag, 'a flag this driver does not know')}" for flag in flags)
