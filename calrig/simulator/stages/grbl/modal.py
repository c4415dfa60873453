"""The words that stay in force from one line of G-code to the next, until a reset."""

from __future__ import annotations

MM_PER_INCH = 25.4
MOST_TOOLS = 255
GROUPS = {0: "motion", 1: "motion", 20: "units", 21: "units", 90: "distance", 91: "distance", 94: "feed"}


class Modal:
    """What a line of G-code leaves in force."""

    def __init__(self) -> None:
        self.feed_dpm: float | None = None
        self._numbers = {"motion": 0, "units": 21, "distance": 90, "feed": 94}
        self._tool = 0

    @property
    def rapid(self) -> bool:
        """Whether moves go as fast as they can."""
        return self._numbers["motion"] == 0

    @property
    def absolute(self) -> bool:
        """Whether a number is a place, and not a way."""
        return self._numbers["distance"] == 90

    @property
    def unit_deg(self) -> float:
        """What 1 is."""
        return MM_PER_INCH if self._numbers["units"] == 20 else 1.0

    def take(self, letter: str, number: float) -> bool:
        """Takes in a word that stays in force; whether it is one. A feed is in the units of its own line."""
        if letter == "G" and number in GROUPS:
            self._numbers[GROUPS[int(number)]] = int(number)
        elif letter == "T" and number <= MOST_TOOLS:
            self._tool = int(number)
        else:
            return False
        return True

    def __str__(self) -> str:
        motion, units, distance, feed = self._numbers.values()
        modes = f"G{motion} G54 G17 G{units} G{distance} G{feed} M5 M9"
        return f"{modes} T{self._tool} F{(self.feed_dpm or 0) / self.unit_deg:g} S0"
