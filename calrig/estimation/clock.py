"""How fast one clock runs by another, from times that both gave to the same events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray

FEWEST = 8
SHORTEST_S = 20.0
MOST_ERROR = 0.05
"""A ceramic resonator is within 1 %; clocks that differ by more are not meant to be the same time."""


@dataclass(frozen=True, slots=True)
class ClockRate:
    """By how much a clock is fast, as a share, and the standard error of that."""

    error: float
    std: float


def clock_rate(clock_s: Sequence[FloatArray], reference_s: Sequence[FloatArray]) -> ClockRate | None:
    """Least squares line through each run's pairs of times, one slope for all.

    Events that are told late scatter about the line, and the standard error is made of that scatter.

    `clock_s` are of each run (n,) times by the clock that is judged, `reference_s` the same events by the
    other.

    Returns:
        None where the runs are too short or the clocks are not of one time.
    """
    x = np.concatenate([times - times.mean() for times in reference_s])
    y = np.concatenate([times - times.mean() for times in clock_s])
    power, freedom = float(x @ x), len(x) - len(reference_s) - 1
    if len(x) < FEWEST or freedom < 1 or np.ptp(x) < SHORTEST_S:
        return None
    slope = float(x @ y) / power
    left = y - slope * x
    if abs(slope - 1.0) > MOST_ERROR:
        return None
    return ClockRate(slope - 1.0, math.sqrt(float(left @ left) / freedom / power))
