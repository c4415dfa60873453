"""How two generations of GRBL word what they say: 1.1 in bars and numbers, those before it in commas."""

from __future__ import annotations

from enum import StrEnum

from calrig.simulator.config import StageOptions

LETTERS = "XYZABC"
HARD_LIMIT, SOFT_LIMIT, RESET_IN_MOTION, RESET_IN_HOMING, NO_SWITCH = 1, 2, 3, 6, 9
STEPS_PER_DEG = 200.0
BUILD = "20190830"
_ALARMS_BEFORE_1_1 = {
    HARD_LIMIT: "Hard limit",
    SOFT_LIMIT: "Soft limit",
    RESET_IN_MOTION: "Abort during cycle",
    RESET_IN_HOMING: "Abort during cycle",
    NO_SWITCH: "Homing fail",
}


class State(StrEnum):
    """The states this one comes into, as `?` says them."""

    IDLE = "Idle"
    RUN = "Run"
    HOLDING = "Hold:1"
    HOLD = "Hold:0"
    HOME = "Home"
    ALARM = "Alarm"


class Words:
    """What one version says: `version` as its banner has it."""

    def __init__(self, version: str) -> None:
        self.version = version
        self._old = version.startswith("0.")

    @property
    def banner(self) -> str:
        """What it says when it begins."""
        return f"Grbl {self.version} ['$' for help]"

    def report(self, state: State, places: list[str]) -> str:
        """The answer to `?`; work and machine coordinates are one."""
        place = ",".join(places)
        if self._old:
            return f"<{state.partition(':')[0]},MPos:{place},WPos:{place}>"
        return f"<{state}|MPos:{place}|FS:0,0>"

    def build(self) -> str:
        """The answer to `$I`."""
        if self._old:
            return f"[{self.version}.{BUILD}:]"
        return f"[VER:{self.version}.{BUILD}:]\r\n[OPT:V,15,128]"

    def modes(self, words: str) -> str:
        """The answer to `$G`."""
        return f"[{words}]" if self._old else f"[GC:{words}]"

    def alarm(self, number: int) -> str:
        """An alarm."""
        return f"ALARM: {_ALARMS_BEFORE_1_1[number]}" if self._old else f"ALARM:{number}"

    def remark(self, text: str) -> str:
        """A message that nobody asked for."""
        return f"[{text}]" if self._old else f"[MSG:{text}]"


def settings(options: StageOptions, index: int) -> dict[int, str]:
    """What `$$` lists, with the axes up to the one that turns."""
    low, high = options.limits_deg
    switch = str(int(options.homing))
    axes = {
        100: STEPS_PER_DEG,
        110: options.velocity_dps * 60,
        120: options.acceleration_dps2,
        130: max(-low, high),
    }
    return {10: "1", 13: "0", 20: switch, 21: switch, 22: switch} | {
        first + axis: f"{value:.3f}" for first, value in axes.items() for axis in range(index + 1)
    }
