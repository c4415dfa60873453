"""Simulated time. Nothing else in the program knows how fast it runs."""

from __future__ import annotations

import time
from collections.abc import Callable


class ScaledClock:
    """Seconds of simulated time since it was made: `time_scale` for every second of `now_s`."""

    def __init__(self, time_scale: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._time_scale = time_scale
        self._now_s = now_s
        self._start_s = now_s()

    def __call__(self) -> float:
        """The simulated time in seconds; never goes back."""
        return self._time_scale * (self._now_s() - self._start_s)
