"""An MPU-6050: vectors in, registers out, through the chip's digital low-pass filters."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calrig.simulator.config import ImuOptions, Pair
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
        """Return what passes of periodic signals, at the instants at which the cycles begin.

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


Counts = npt.NDArray[np.int16]

FULL_SCALE_COUNTS = 32768
TEMPERATURE_COUNTS_PER_C = 340.0
TEMPERATURE_OFFSET_C = 36.53
"""Register map RM-MPU-6000A, section 4.18: temperature = counts/340 + 36.53."""

AXES = "xyz"


class Surroundings(NamedTuple):
    """What acts on the sensor besides motion, each (n,): temperatures, and the supply less its nominal."""

    die_c: FloatArray
    stress_c: FloatArray
    supply_error_v: FloatArray


class Noise(NamedTuple):
    """What is added at n samples: white noise and the biases' walks; (n, 3), the temperature's (n,)."""

    accel_g: FloatArray
    gyro_dps: FloatArray
    temperature_c: FloatArray


class NoiseSource:
    """Noise drawn sample after sample: how the samples are cut into blocks changes nothing."""

    def __init__(self, options: ImuOptions, seed: np.random.SeedSequence) -> None:
        self._options = options
        self._white, self._steps = (np.random.default_rng(child) for child in seed.spawn(2))
        self._walk_per_rts = np.repeat(
            [1e-3 * options.accel_walk_mg_per_rts, options.gyro_walk_dps_per_rts], 3
        )
        self._last_s = 0.0
        self._walk = np.zeros((1, 6))

    def draw(self, times_s: FloatArray, rate_hz: float) -> Noise:
        """The noise of the next samples, taken at `times_s` (n,), each band-limited to half the rate.

        A one-sided density N gives samples of standard deviation N·√(rate/2).
        """
        options = self._options
        normal = self._white.standard_normal((len(times_s), 7))
        root_bandwidth = math.sqrt(0.5 * rate_hz)
        walk = self._walked(times_s)
        return Noise(
            1e-6 * options.accel_noise_ug_per_rthz * root_bandwidth * normal[:, 0:3] + walk[:, 0:3],
            options.gyro_noise_dps_per_rthz * root_bandwidth * normal[:, 3:6] + walk[:, 3:6],
            options.temperature_noise_c * normal[:, 6],
        )

    def _walked(self, times_s: FloatArray) -> FloatArray:
        if not self._walk_per_rts.any() or not len(times_s):
            return np.zeros((1, 6))
        since_s = np.maximum(np.diff(times_s, prepend=self._last_s), 0.0)
        normal = self._steps.standard_normal((len(times_s), 6))
        steps = normal * self._walk_per_rts * np.sqrt(since_s)[:, None]
        walk = np.cumsum(np.concatenate([self._walk, steps]), axis=0)
        self._last_s, self._walk = float(times_s[-1]), walk[-1:]
        return walk[1:]


class Imu:
    """Everything between the true vectors and the chip's registers, but for the noise."""

    def __init__(self, options: ImuOptions) -> None:
        self._options = options
        self._cross_axis = _cross_axis(options.accel_cross_axis_deg)
        self._gyro_cross_axis = _cross_axis(options.gyro_cross_axis_deg)
        self._gyro_dps_per_g = np.array(options.gyro_dps_per_g)

    def package_turn_deg(self, stress_c: FloatArray) -> FloatArray:
        """How far temperature has turned the die in its package about x."""
        return self._options.package_turn_deg_per_c * (stress_c - self._options.reference_c)

    def accel_g(self, force_g: FloatArray, around: Surroundings) -> FloatArray:
        """What the accelerometer makes of a specific force (..., n, 3).

        Per axis: gain·(a + crosstalk) + quadratic + cubic term + bias, gain and bias moving with temperature
        and the bias with the supply.
        """
        options = self._options
        drift_c = (around.stress_c - options.reference_c)[:, None]
        felt = force_g @ self._cross_axis.T
        gain_drift_pct = drift_c * np.asarray(options.accel_gain_pct_per_c)
        gain = 1 + 0.01 * (np.asarray(options.accel_gain_error_pct) + gain_drift_pct)
        bias_mg = (
            np.asarray(options.accel_bias_mg)
            + drift_c * np.asarray(options.accel_bias_mg_per_c)
            + around.supply_error_v[:, None] * np.asarray(options.accel_bias_mg_per_v)
            + felt**2 * np.asarray(options.accel_quadratic_mg_per_g2)
            + felt**3 * np.asarray(options.accel_cubic_mg_per_g3)
        )
        measured: FloatArray = gain * felt + 1e-3 * bias_mg
        return measured

    def gyro_dps(self, rate_dps: FloatArray, force_g: FloatArray, around: Surroundings) -> FloatArray:
        """What the gyro makes of an angular rate (n, 3) under a specific force (..., n, 3)."""
        options = self._options
        drift_c = (around.stress_c - options.reference_c)[:, None]
        bias = np.asarray(options.gyro_bias_dps) + drift_c * np.asarray(options.gyro_bias_dps_per_c)
        scale = 1 + 0.01 * np.asarray(options.gyro_scale_error_pct)
        felt_dps = rate_dps @ self._gyro_cross_axis.T
        measured: FloatArray = scale * felt_dps + bias + force_g @ self._gyro_dps_per_g.T
        return measured

    def registers(self, accel_g: FloatArray, gyro_dps: FloatArray, die_c: FloatArray) -> Counts:
        """The chip's registers (n, 7): ax ay az temp gx gy gz, rounded and saturated at 16 bits."""
        columns = [
            accel_g * (FULL_SCALE_COUNTS / self._options.accel_range_g),
            ((die_c - TEMPERATURE_OFFSET_C) * TEMPERATURE_COUNTS_PER_C)[:, None],
            gyro_dps * (FULL_SCALE_COUNTS / self._options.gyro_range_dps),
        ]
        rounded = np.rint(np.concatenate(columns, axis=1))
        return np.clip(rounded, -FULL_SCALE_COUNTS, FULL_SCALE_COUNTS - 1).astype(np.int16)


def _cross_axis(angles_deg: Mapping[Pair, float]) -> FloatArray:
    """(3, 3) what each axis measures of the others, on top of itself."""
    mixed = np.eye(3)
    for pair, angle_deg in angles_deg.items():
        mixed[AXES.index(pair[0]), AXES.index(pair[1])] = math.sin(math.radians(angle_deg))
    return mixed
