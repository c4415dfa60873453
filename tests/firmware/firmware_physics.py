"""What the simulated sensor feels, worked out by hand: no part of calrig is asked."""

from __future__ import annotations

import math

import numpy as np

COUNTS_PER_G, COUNTS_PER_DPS = 16384, 32768 / 250


class Swing:
    """A sensor that swings about its x axis, past the upside-down, with noise of a few counts.

    Elevation is 60 + 130·sin(2π·t/5 s) degrees; the gyro is off by 3 °/s.
    """

    def __init__(self) -> None:
        self._noise = np.random.default_rng(5)

    def __call__(self, time_s: float) -> np.ndarray:
        phase = 2 * math.pi * time_s / 5
        turn = math.radians(60 + 130 * math.sin(phase))
        rate_dps = 130 * 2 * math.pi / 5 * math.cos(phase) + 3.0
        force = [0.0, COUNTS_PER_G * math.sin(turn), COUNTS_PER_G * math.cos(turn)]
        felt = [*force, -3900.0, COUNTS_PER_DPS * rate_dps, 20.0, -30.0]
        return np.clip(np.rint(felt + self._noise.normal(0, 15, 7)), -32768, 32767).astype(np.int16)


class Served:
    """Remembers what it gave the sensor, and when."""

    def __init__(self, counts: Swing) -> None:
        self._give = counts
        self.times_s: list[float] = []
        self.counts: list[np.ndarray] = []

    def __call__(self, time_s: float) -> np.ndarray:
        counts = self._give(time_s)
        self.times_s.append(time_s)
        self.counts.append(counts)
        return counts
