"""The Kalman filter's start: gains that change from sample to sample until they are steady.

They depend on the noise assumed and on dt, not on the data: firmware that cannot run the covariance's
recursion may take them from a table, and go on with the steady gain after the last.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray
from calrig.estimation.kalman import KalmanFilter, KalmanNoise
from calrig.estimation.steady import SteadyGain, steady_gain

_CONVERGED = 1e-9
_CHUNK = 1024


def gain_schedule(noise: KalmanNoise, dt_s: float, n: int) -> tuple[FloatArray, FloatArray]:
    """The gains of the first `n` samples at uniform dt: of the angle (1) and of the bias (1/s), (n,) each.

    The first sample starts the filter: gains 1 and 0, P = diag(R, `INITIAL_BIAS_VARIANCE`). From there on
    they are those of the recursion of `KalmanFilter`, and the steady ones once it has converged.

    Raises:
        ValueError: an interval not above 0.
    """
    steady = steady_gain(noise, dt_s)
    kalman = KalmanFilter(noise)
    gains = np.empty((n, 2))
    for begin in range(0, n, _CHUNK):
        end = min(begin + _CHUNK, n)
        for index in range(begin, end):
            kalman.update(0.0, 0.0, dt_s)
            gains[index] = kalman.covariance[0]  # (k_angle, k_bias)·R
        if np.allclose(kalman.covariance, steady.covariance, rtol=_CONVERGED, atol=0.0):
            gains[end:] = steady.covariance[0]
            break
    gains /= noise.r_deg2
    return gains[:, 0], gains[:, 1]


def samples_to_steady(
    noise: KalmanNoise, dt_s: float, within: float = 0.01, at_most_s: float = 600.0
) -> int | None:
    """After how many samples both gains are, and stay, within a share of the steady ones.

    Args:
        noise: what the filter assumes.
        dt_s: the sampling interval.
        within: the share.
        at_most_s: how far to look.

    Returns:
        None where it takes longer than `at_most_s`, or for ever: with q_bias 0 the bias is learnt once and
        for all, by a gain that goes on falling.
    """
    if noise.q_bias == 0.0:
        return None
    steady = steady_gain(noise, dt_s)
    n = max(2, round(at_most_s / dt_s))
    outside = _off_steady(gain_schedule(noise, dt_s, n), steady) > within
    samples = n - int(np.argmax(outside[::-1]))
    return samples if samples < n else None


def _off_steady(gains: tuple[FloatArray, FloatArray], steady: SteadyGain) -> npt.NDArray[np.float64]:
    off_angle = np.abs(gains[0] / steady.k_angle - 1.0)
    return np.maximum(off_angle, np.abs(gains[1] / steady.k_bias - 1.0))
