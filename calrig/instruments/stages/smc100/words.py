"""What an SMC100 says in codes, in words (SMC100CC/PP user's manual, commands TS and TE)."""

from __future__ import annotations

BAUDRATE = 57600

STATES = {
    "0A": ("not_referenced", "NOT REFERENCED from reset"),
    "0B": ("not_referenced", "NOT REFERENCED from HOMING"),
    "0C": ("not_referenced", "NOT REFERENCED from CONFIGURATION"),
    "0D": ("not_referenced", "NOT REFERENCED from DISABLE"),
    "0E": ("not_referenced", "NOT REFERENCED from READY"),
    "0F": ("not_referenced", "NOT REFERENCED from MOVING"),
    "10": ("not_referenced", "NOT REFERENCED, the stage's memory reports an error"),
    "11": ("not_referenced", "NOT REFERENCED from JOGGING"),
    "14": ("configuration", "CONFIGURATION"),
    "1E": ("homing", "HOMING commanded over the wire"),
    "1F": ("homing", "HOMING commanded by the keypad"),
    "28": ("moving", "MOVING"),
    "32": ("ready", "READY from HOMING"),
    "33": ("ready", "READY from MOVING"),
    "34": ("ready", "READY from DISABLE"),
    "35": ("ready", "READY from JOGGING"),
    "3C": ("disabled", "DISABLE from READY"),
    "3D": ("disabled", "DISABLE from MOVING"),
    "3E": ("disabled", "DISABLE from JOGGING"),
    "46": ("moving", "JOGGING from READY"),
    "47": ("moving", "JOGGING from DISABLE"),
}

ERROR_BITS = (
    "negative end of run",
    "positive end of run",
    "peak current limit",
    "RMS current limit",
    "short circuit",
    "following error",
    "homing time-out",
    "wrong stage",
    "DC voltage too low",
    "80 W output power exceeded",
)

ERRORS = {
    "A": "unknown command",
    "B": "wrong controller address",
    "C": "parameter missing or out of range",
    "D": "command not allowed",
    "E": "home sequence already started",
    "F": "error code F, which the manual leaves unused",
    "G": "displacement out of limits",
    "H": "not allowed in NOT REFERENCED: home the stage first",
    "I": "not allowed in CONFIGURATION",
    "J": "not allowed in DISABLE",
    "K": "not allowed in READY",
    "L": "not allowed in HOMING",
    "M": "not allowed in MOVING",
    "N": "position out of the controller's software limit",
    "S": "communication time-out",
    "U": "error of the controller's EEPROM",
    "V": "error while executing the command",
    "W": "command not for this version",
    "X": "command not for this stage",
}
