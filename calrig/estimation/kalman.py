"""The two-state Kalman filter of elevation and gyro bias, sample by sample or by blocks.

The filter is that of Nirmal et al., "Noise modeling and analysis of an IMU-based attitude sensor", Proc. SPIE
9912 (2016), doi:10.1117/12.2234255: state angle a (deg) and gyro bias b (deg/s), the rate u as input, the
accelerometer's elevation z as measurement. With dt from the board's clock:

    predict   a ← a + dt·(u − b),  P ← F·P·Fᵀ + diag(q_angle, q_bias)·dt,  F = [[1, −dt], [0, 1]]
    update    y = z − a wrapped to (−180, 180],  K = P·Hᵀ/(H·P·Hᵀ + R),  x ← x + K·y,  P ← (I − K·H)·P

The gain depends on dt alone and not on the data; what follows from that is in `calrig.estimation.gains`.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray, wrap_deg

INITIAL_BIAS_VARIANCE = 1.0
"""(deg/s)². One second of settling at 200 Hz pins the bias to about 12·R/(n·T²) = 0.002 (deg/s)² by itself:
500 times tighter than this, so that even a data sheet's worst zero-rate output (MPU-6050: ±20 °/s) is then
forgotten to 0.05 °/s. Much wider would let the noise of the first few samples throw the bias about."""


@dataclass(frozen=True, slots=True)
class KalmanNoise:
    """Noise the filter assumes: Q in deg² and (deg/s)² per second, R in deg² per sample (CONTRACT 4)."""

    q_angle: float = 0.001
    q_bias: float = 0.003
    r_deg2: float = 0.03

    def __post_init__(self) -> None:
        for value in (self.q_angle, self.q_bias, self.r_deg2):
            if not math.isfinite(value):
                raise ValueError(f"{self}: noise must be finite")
        if self.q_angle <= 0 or self.q_bias < 0 or self.r_deg2 <= 0:
            raise ValueError(f"{self}: q_angle and r_deg2 must be above 0 and q_bias not below it")


class KalmanFilter:
    """The filter with its state. Drive one either by `update` or by `run`, not by both in turn.

    It starts at the first elevation measured, whose variance is R; the bias starts at 0 within
    `INITIAL_BIAS_VARIANCE`. The angle is continuous: it goes past ±180° without a jump.

    Args:
        noise: what it assumes.
        gap_s: after so long without a sample it restarts the angle from the next one and keeps the bias:
            what the gyro would have told of a turn meanwhile is lost. The filter of the paper never does.
    """

    __slots__ = ("_angle", "_bias", "_gap_s", "_p00", "_p01", "_p11", "_q_angle", "_q_bias", "_r", "_time_s")

    def __init__(self, noise: KalmanNoise | None = None, gap_s: float = math.inf) -> None:
        noise = noise or KalmanNoise()
        self._q_angle, self._q_bias, self._r = noise.q_angle, noise.q_bias, noise.r_deg2
        self._gap_s = gap_s
        self._angle: float | None = None
        self._bias = 0.0
        self._p00, self._p01, self._p11 = noise.r_deg2, 0.0, INITIAL_BIAS_VARIANCE
        self._time_s = math.nan

    @property
    def angle_deg(self) -> float | None:
        """The filtered elevation, not wrapped; None before the first sample."""
        return self._angle

    @property
    def bias_dps(self) -> float:
        """The gyro bias the filter holds, in degrees per second."""
        return self._bias

    @property
    def covariance(self) -> FloatArray:
        """(2, 2) covariance of angle (deg) and bias (deg/s) after the last update."""
        return np.array([[self._p00, self._p01], [self._p01, self._p11]])

    def update(self, angle_deg: float, rate_dps: float, dt_s: float) -> float:
        """Take one sample and return the filtered angle.

        `angle_deg` may be on any turn; `dt_s` means nothing for the first sample.

        Raises:
            ValueError: a number that is not finite, or time that does not go forward; the state is kept.
        """
        angle = self._angle
        if angle is None:
            return self._start(angle_deg, rate_dps)
        if not dt_s > 0.0:
            raise ValueError(f"time must go forward from sample to sample, dt is {dt_s} s")
        if dt_s > self._gap_s:
            return self._go_on(angle_deg, rate_dps, dt_s, angle)
        m01 = self._p01 - dt_s * self._p11
        m00 = self._p00 + dt_s * (self._q_angle - self._p01 - m01)
        s = m00 + self._r
        k0 = m00 / s
        k1 = m01 / s
        angle += dt_s * (rate_dps - self._bias)
        y = angle_deg - angle
        if not -180.0 < y <= 180.0:  # also true of NaN
            if not math.isfinite(y):
                raise ValueError(f"a sample is not finite: elevation {angle_deg}°, rate {rate_dps} °/s")
            y = wrap_deg(y)
        self._angle = angle = angle + k0 * y
        self._bias += k1 * y
        self._p11 += dt_s * self._q_bias - k1 * m01
        # (1 − k0)·m = k·R: no difference of nearly equal numbers
        self._p00 = k0 * self._r
        self._p01 = k1 * self._r
        return angle

    def run(self, time_s: npt.ArrayLike, elevation_deg: npt.ArrayLike, rate_dps: npt.ArrayLike) -> FloatArray:
        """Filter a block with the board's own times, continuing from the block before.

        Args:
            time_s: (n,) the board's clock, strictly increasing, also from the block before.
            elevation_deg: (n,) elevation of the accelerometer.
            rate_dps: (n,) angular rate about the axis of elevation.

        Returns:
            (n,) filtered angle, continuous.

        Raises:
            ValueError: shapes that differ, a number that is not finite, time that does not go forward;
                nothing of the block is taken then.
        """
        times, elevations, rates = (
            np.asarray(a, dtype=np.float64) for a in (time_s, elevation_deg, rate_dps)
        )
        if not times.shape == elevations.shape == rates.shape == (len(times),):
            raise ValueError(f"{times.shape} times, {elevations.shape} elevations, {rates.shape} rates")
        if len(times) == 0:
            return np.empty(0)
        steps = np.diff(times, prepend=self._time_s)
        if self._angle is None:
            steps[0] = 1.0  # of no meaning: the first sample only starts the filter
        _check(times, elevations, rates, steps)
        samples = zip(elevations.tolist(), rates.tolist(), steps.tolist(), strict=True)
        update = self.update
        filtered = np.array([update(elevation, rate, step) for elevation, rate, step in samples])
        self._time_s = float(times[-1])
        return filtered

    def _start(self, angle_deg: float, rate_dps: float) -> float:
        if not (math.isfinite(angle_deg) and math.isfinite(rate_dps)):
            raise ValueError(f"a sample is not finite: elevation {angle_deg}°, rate {rate_dps} °/s")
        self._angle = angle_deg
        return angle_deg

    def _go_on(self, angle_deg: float, rate_dps: float, dt_s: float, before_deg: float) -> float:
        """After a gap: the angle as at the start, on the nearer turn; the bias kept, less sure by so long."""
        angle = self._start(before_deg + wrap_deg(angle_deg - before_deg), rate_dps)
        self._p00, self._p01 = self._r, 0.0
        self._p11 += dt_s * self._q_bias
        return angle


def _check(times: FloatArray, elevations: FloatArray, rates: FloatArray, steps: FloatArray) -> None:
    for name, values in (("time", times), ("elevation", elevations), ("rate", rates)):
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise ValueError(f"sample {bad[0]} of the block: {name} is not finite ({values[bad[0]]})")
    bad = np.flatnonzero(~(steps > 0.0))
    if len(bad):
        raise ValueError(
            f"sample {bad[0]} of the block, at {times[bad[0]]} s: time must go forward from sample to sample"
        )
