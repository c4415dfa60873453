"""The Kalman filter at uniform dt: transient gains, the steady-state gain, and the linear filter it becomes.

They depend on the noise assumed and on dt, not on the data: firmware that cannot run the covariance's
recursion may take the transient gains from a table, and go on with the steady-state gain after the last.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray
from calrig.estimation.kalman import KalmanFilter, KalmanNoise

_CONVERGED = 1e-12
"""Relative; the recursion's own rounding leaves 2e-14 at 1 Hz and 1e-13 at 8 kHz."""
_CHUNK = 512
_SCHEDULE_CONVERGED = 1e-9
_SCHEDULE_CHUNK = 1024


@dataclass(frozen=True, slots=True)
class SteadyStateGain:
    """What the filter becomes at one dt: y(n) = w(n) − w(n−1) − a₁·y(n−1) − a₂·y(n−2), w = Δz − dt·u.

    That is the recursion of `KalmanFilter` with its gain constant and the state eliminated: y the
    innovation, angle = z − (1 − k_angle)·y.

    Attributes:
        dt_s: the sampling interval.
        k_angle: gain of the angle, 1.
        k_bias: gain of the bias, 1/s (negative).
        covariance: (2, 2) of angle and bias after an update.
    """

    dt_s: float
    k_angle: float
    k_bias: float
    covariance: FloatArray

    @property
    def denominator(self) -> tuple[float, float, float]:
        """1, a₁, a₂ of the recursion."""
        return 1.0, self.k_angle - self.dt_s * self.k_bias - 2.0, 1.0 - self.k_angle

    def response(self, omega: FloatArray) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.complex128]]:
        """Frequency responses elevation → filtered angle (1) and rate → filtered angle (s).

        `omega` (m,) is in radians per sample, not 0.
        """
        q = np.exp(-1j * omega)
        one, a1, a2 = self.denominator
        denominator = one + q * (a1 + q * a2)
        elevation = (self.k_angle - (self.k_angle + self.dt_s * self.k_bias) * q) / denominator
        rate = self.dt_s * (1.0 - self.k_angle) * (1.0 - q) / denominator
        return elevation, rate


def steady_state_gain(noise: KalmanNoise, dt_s: float) -> SteadyStateGain:
    """Return the gain to which the filter converges at uniform dt, in closed form.

    Setting the covariance after an update equal to that before the next prediction, and s = √(1 − k_angle),
    leaves a palindromic quartic, s⁴ − β·s³ − (2 + κ)·s² − β·s + 1 = 0 with β = dt·√(q_bias·dt/R) and
    κ = q_angle·dt/R; t = s + 1/s makes it the quadratic t² − β·t − (4 + κ) = 0. It solves the discrete
    algebraic Riccati equation (Anderson & Moore, Optimal Filtering, 1979, section 4.4), to the last digit
    and also at q_bias = 0, where a general solver finds a pole on the unit circle.
    """
    if not (dt_s > 0 and math.isfinite(dt_s)):
        raise ValueError(f"the sampling interval must be above 0 s, not {dt_s}")
    beta = dt_s * math.sqrt(noise.q_bias * dt_s / noise.r_deg2)
    kappa = noise.q_angle * dt_s / noise.r_deg2
    t = (beta + math.sqrt(beta * beta + 4.0 * (4.0 + kappa))) / 2.0
    d2 = beta * t + kappa  # t² − 4, without the difference
    d = math.sqrt(d2)
    s = 2.0 / (t + d)
    k_angle = (1.0 + s) * (d + d2 / (t + 2.0)) / (t + d)
    k_bias = -s * math.sqrt(noise.q_bias * dt_s / noise.r_deg2)
    innovation_variance = noise.r_deg2 / (s * s)
    p01 = k_bias * noise.r_deg2
    p11 = -k_bias * k_angle * innovation_variance / dt_s
    return SteadyStateGain(dt_s, k_angle, k_bias, np.array([[k_angle * noise.r_deg2, p01], [p01, p11]]))


def gain_schedule(noise: KalmanNoise, dt_s: float, n: int) -> tuple[FloatArray, FloatArray]:
    """The gains of the first `n` samples at uniform dt: of the angle (1) and of the bias (1/s), (n,) each.

    The first sample starts the filter: gains 1 and 0, P = diag(R, `INITIAL_BIAS_VARIANCE`). From there on
    they are those of the recursion of `KalmanFilter`, and the steady ones once it has converged.

    Raises:
        ValueError: an interval not above 0.
    """
    steady = steady_state_gain(noise, dt_s)
    kalman = KalmanFilter(noise)
    gains = np.empty((n, 2))
    for begin in range(0, n, _SCHEDULE_CHUNK):
        end = min(begin + _SCHEDULE_CHUNK, n)
        for index in range(begin, end):
            kalman.update(0.0, 0.0, dt_s)
            gains[index] = kalman.covariance[0]  # (k_angle, k_bias)·R
        if np.allclose(kalman.covariance, steady.covariance, rtol=_SCHEDULE_CONVERGED, atol=0.0):
            gains[end:] = steady.covariance[0]
            break
    gains /= noise.r_deg2
    return gains[:, 0], gains[:, 1]


def samples_to_steady_state(
    noise: KalmanNoise, dt_s: float, within: float = 0.01, at_most_s: float = 600.0
) -> int | None:
    """After how many samples both gains are, and stay, within a share of the steady ones.

    Returns:
        None where it takes longer than `at_most_s`, or for ever: with q_bias 0 the bias is learnt once and
        for all, by a gain that goes on falling.
    """
    if noise.q_bias == 0.0:
        return None
    steady = steady_state_gain(noise, dt_s)
    n = max(2, round(at_most_s / dt_s))
    k_angle, k_bias = gain_schedule(noise, dt_s, n)
    off = np.maximum(np.abs(k_angle / steady.k_angle - 1.0), np.abs(k_bias / steady.k_bias - 1.0))
    samples = n - int(np.argmax(off[::-1] > within))
    return samples if samples < n else None


def filter_uniform(
    elevation_deg: npt.ArrayLike, rate_dps: npt.ArrayLike, dt_s: float, noise: KalmanNoise | None = None
) -> FloatArray:
    """Filter a whole log taken at one interval: what `KalmanFilter` gives, to 1e-9°, far faster.

    The recursion runs until its covariance has converged to machine precision, from there on a linear
    filter. Where the elevation jumps half a turn away from the filter, the recursion does it all.

    `elevation_deg` (n,) is of the accelerometer, `rate_dps` (n,) about its axis; `noise` is what the filter
    assumes.

    Returns:
        (n,) filtered angle, continuous.

    Raises:
        ValueError: shapes that differ, a number that is not finite, an interval not above 0.
    """
    noise = noise or KalmanNoise()
    z = np.asarray(elevation_deg, dtype=np.float64)
    u = np.asarray(rate_dps, dtype=np.float64)
    if z.shape != u.shape or z.ndim != 1:
        raise ValueError(f"elevation {z.shape} and rate {u.shape} must be equally long and flat")
    gain = steady_state_gain(noise, dt_s)
    kalman = KalmanFilter(noise)
    filtered = np.empty(len(z))
    done, chunk = 0, _CHUNK
    while done < len(z):
        if chunk == _CHUNK and np.allclose(kalman.covariance, gain.covariance, rtol=_CONVERGED, atol=0.0):
            rest = _filter_steady(z[done:], u[done:], gain, kalman)
            if rest is not None:
                filtered[done:] = rest
                return filtered
            chunk = len(z)
        end = min(done + chunk, len(z))
        block = zip(z[done:end].tolist(), u[done:end].tolist(), strict=True)
        filtered[done:end] = [kalman.update(elevation, rate, dt_s) for elevation, rate in block]
        done = end
    return filtered


def _filter_steady(
    z: FloatArray, u: FloatArray, gain: SteadyStateGain, kalman: KalmanFilter
) -> FloatArray | None:
    """The linear filter from the state of `kalman` on; None where an innovation reaches half a turn."""
    from scipy.signal import lfilter

    w = -gain.dt_s * u
    w[1:] += np.diff(z)
    w[0] += z[0] - (kalman.angle_deg or 0.0)
    if not max(w.max(), -w.min()) <= 180.0:
        turns_deg = w / 360.0  # in place from here on: new arrays of a long log cost more than the arithmetic
        np.rint(turns_deg, out=turns_deg)
        turns_deg *= 360.0
        w -= turns_deg
        z = z - np.cumsum(turns_deg, out=turns_deg)
    y, _ = lfilter([1.0, -1.0], gain.denominator, w, zi=np.array([gain.dt_s * kalman.bias_dps, 0.0]))
    if not max(y.max(), -y.min()) < 180.0:  # also true of NaN
        return None
    y *= gain.k_angle - 1.0
    y += z
    return np.asarray(y, dtype=np.float64)
