"""What an SMC100 calls its states and errors (SMC100CC/PP user's manual, commands TS, TE and TB)."""

from __future__ import annotations

from enum import IntEnum

NO_ERROR = "@"
ERROR_TEXTS = {
    "@": "No error",
    "A": "Unknown message code or floating point controller address",
    "B": "Controller address not correct",
    "C": "Parameter missing or out of range",
    "D": "Command not allowed",
    "E": "Home sequence already started",
    "G": "Displacement out of limits",
    "H": "Command not allowed in NOT REFERENCED state",
    "I": "Command not allowed in CONFIGURATION state",
    "J": "Command not allowed in DISABLE state",
    "K": "Command not allowed in READY state",
    "L": "Command not allowed in HOMING state",
    "M": "Command not allowed in MOVING state",
    "N": "Current position out of software limit",
    "S": "Communication time-out",
    "U": "Error during EEPROM access",
    "V": "Error during command execution",
    "W": "Command not allowed for PP version",
    "X": "Command not allowed for CC version",
}
FOLLOWING_ERROR = 1 << 5
HOMING_TIME_OUT = 1 << 6


class State(IntEnum):
    """The controller's states, by the code that `TS` gives; the names say where each was entered from."""

    NOT_REFERENCED_FROM_RESET = 0x0A
    NOT_REFERENCED_FROM_HOMING = 0x0B
    HOMING = 0x1E
    MOVING = 0x28
    READY_FROM_HOMING = 0x32
    READY_FROM_MOVING = 0x33
    READY_FROM_DISABLE = 0x34
    DISABLE_FROM_READY = 0x3C
    DISABLE_FROM_MOVING = 0x3D


NOT_REFERENCED = {State.NOT_REFERENCED_FROM_RESET, State.NOT_REFERENCED_FROM_HOMING}
READY = {State.READY_FROM_HOMING, State.READY_FROM_MOVING, State.READY_FROM_DISABLE}
DISABLE = {State.DISABLE_FROM_READY, State.DISABLE_FROM_MOVING}
REFUSALS = (
    (NOT_REFERENCED, "H"),
    (DISABLE, "J"),
    (READY, "K"),
    ({State.HOMING}, "L"),
    ({State.MOVING}, "M"),
)
