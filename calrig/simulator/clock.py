"""Simulated time. Nothing else in the program knows how fast it runs."""

from __future__ import annotations

import time


class ScaledClock:
    """Seconds of simulated time since it was made: `time_scale` for every second of the wall's."""

    def __init__(self, time_scale: float) -> None:
        self._time_scale = time_scale
        self._start_s = time.monotonic()

    def __call__(self) -> float:
        """The simulated time in seconds; never goes back."""
        return self._time_scale * (time.monotonic() - self._start_s)
