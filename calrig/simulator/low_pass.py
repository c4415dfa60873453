"""The chip's digital low-pass filters: what comes later through them, and what comes weaker."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calrig.simulator.trajectory import FloatArray


class LowPass(NamedTuple):
    """One channel's filter.

    What turns on purpose is far slower than the filter: it comes through whole, by the data sheet's delay
    late. Vibration need not be slow: it is attenuated as by a first order of that bandwidth. The data sheet
    names no order, and none attenuates less.
    """

    bandwidth_hz: float
    delay_s: float

    def passes(self, frequency_hz: FloatArray) -> FloatArray:
        """How much of a wave's amplitude is left."""
        return np.asarray(1 / np.hypot(1.0, frequency_hz / self.bandwidth_hz))

    def of_cycle(self, cycle: FloatArray, frequency_hz: FloatArray) -> FloatArray:
        """What is left of signals that repeat themselves, at the instants at which the cycles begin.

        Args:
            cycle: (k, n, 3) k equidistant values over one cycle, from each of n instants on, free of waves of
                k/2 cycles and more.
            frequency_hz: (n,) cycles per second.
        """
        spectrum = np.fft.rfft(cycle, axis=0)
        orders = np.arange(len(spectrum))[:, None, None]
        filtered = spectrum * self.passes(orders * frequency_hz[:, None])
        at_beginning: FloatArray = np.fft.irfft(filtered, n=len(cycle), axis=0)[0]
        return at_beginning


class LowPasses(NamedTuple):
    """The two channels' filters."""

    accel: LowPass
    gyro: LowPass


NO_LOW_PASS = LowPass(math.inf, 0.0)
DLPF = (
    LowPasses(LowPass(260.0, 0.0), LowPass(256.0, 0.98e-3)),
    LowPasses(LowPass(184.0, 2.0e-3), LowPass(188.0, 1.9e-3)),
    LowPasses(LowPass(94.0, 3.0e-3), LowPass(98.0, 2.8e-3)),
    LowPasses(LowPass(44.0, 4.9e-3), LowPass(42.0, 4.8e-3)),
    LowPasses(LowPass(21.0, 8.5e-3), LowPass(20.0, 8.3e-3)),
    LowPasses(LowPass(10.0, 13.8e-3), LowPass(10.0, 13.4e-3)),
    LowPasses(LowPass(5.0, 19.0e-3), LowPass(5.0, 18.6e-3)),
)
"""By DLPF_CFG: bandwidths and delays of the register map, RM-MPU-6000A rev. 4.2, section 4.3."""


def low_passes(dlpf_cfg: int | None) -> LowPasses:
    """The filters of a setting; without one, filters that change nothing."""
    return LowPasses(NO_LOW_PASS, NO_LOW_PASS) if dlpf_cfg is None else DLPF[dlpf_cfg]
