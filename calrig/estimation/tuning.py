"""The Kalman filter's constants from the unit's own noise, as its Allan deviation gives it.

With σ(τ) = N/√τ (white), 0.664·B (flicker, at its floor) and K·√(τ/3) (random walk), IEEE Std 952-1997,
annex C, the noise that the filter's equations speak of is

    q_angle = N_gyro²     the angle's random walk, deg² per second
    q_bias  = K_gyro²     the bias's walk, (deg/s)² per second
    R       = N_elevation²·rate      deg² per sample

R is not the variance of a sample. Where the chip's low-pass makes neighbours alike, their variance is smaller
than R and their sum no better known: what the filter must be told is the density at low frequency, R·dt = N².
"""

import math

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.estimation.kalman import KalmanNoise

FLICKER_FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""0.664: Allan deviation at its floor over B."""
BIAS_HORIZON_S = 30.0
"""For which a bias is trusted to stay where no wandering of it was seen. Measured at an MPU-6050's noise,
this costs less than 1 % of jitter, and a bias that drifts while the chip warms (0.01 °/s a minute) then
leaves 0.01° in the angle instead of running away."""


def tuned_noise(
    *,
    white_elevation_deg_sqrt_s: float,
    white_gyro_dps_sqrt_s: float,
    rate_hz: float,
    random_walk_gyro_dps_per_sqrt_s: float | None = None,
    flicker_gyro_dps: float | None = None,
    gyro_scale_std: float = 0.0,
    turning_deg_per_sqrt_s: float = 0.0,
) -> KalmanNoise:
    """Return the constants of the filter for one unit.

    The bias's walk is the largest of three. K, where the Allan deviation shows a random walk. Where it shows
    flicker, which no random walk is, the walk that reaches the floor just where the white noise does, at
    τ = (N/0.664·B)²: K² = 3·(0.664·B)⁴/N². And in any case the walk that the white noise would have hidden
    up to `BIAS_HORIZON_S`: K² = 3·N²/horizon².

    Trusting a gyro as its noise deserves makes the filter hold on to what its *scale* gets wrong in a move
    of Δ, s·Δ, for √(R·dt/q_angle): seconds. Calibrate the scale; what is still uncertain of it can be
    told, and enters as the random walk that moves make of it, q_angle += (s·√(Σ Δ²/T))².

    Args:
        white_elevation_deg_sqrt_s: N of the accelerometer's elevation.
        white_gyro_dps_sqrt_s: N of the rate about the axis of elevation, (deg/s)·√s, that is deg/√s.
        rate_hz: samples a second.
        random_walk_gyro_dps_per_sqrt_s: K of that rate, (deg/s)/√s; None where none was seen.
        flicker_gyro_dps: B of that rate, deg/s; None where none was seen.
        gyro_scale_std: relative standard error of the gyro's scale (0.01 for 1 %).
        turning_deg_per_sqrt_s: √(Σ Δ²/T) of the motion in use: 10° every 4 s is 5 °/√s.

    Raises:
        ValueError: a coefficient or rate that is not above 0, or below it where 0 is allowed.
    """
    n = white_gyro_dps_sqrt_s
    for name, value in (("elevation's white noise", white_elevation_deg_sqrt_s), ("gyro's", n)):
        _check(name, value, value > 0)
    _check("rate", rate_hz, rate_hz > 0)
    walk, flicker = random_walk_gyro_dps_per_sqrt_s or 0.0, flicker_gyro_dps or 0.0
    others = ("random walk", walk), ("flicker", flicker), ("scale's error", gyro_scale_std)
    for name, value in (*others, ("turning", turning_deg_per_sqrt_s)):
        _check(name, value, value >= 0)
    floor = FLICKER_FLOOR * flicker
    return KalmanNoise(
        q_angle=float(n**2 + (gyro_scale_std * turning_deg_per_sqrt_s) ** 2),
        q_bias=float(max(walk**2, 3.0 * floor**4 / n**2, 3.0 * n**2 / BIAS_HORIZON_S**2)),
        r_deg2=float(white_elevation_deg_sqrt_s**2 * rate_hz),
    )


def midpoint_rate_dps(rate_dps: FloatArray) -> FloatArray:
    """Return the rate between each sample and the one before: what a step of the filter is to be driven by.

    a + dt·u(n) gives each step the rate of its end, and so runs half an interval ahead of a sensor that
    turns: 2.5 ms at 200 Hz, 0.05° at 20 °/s. The paper's constants pull that back within half a second; a
    filter tuned to a quiet gyro keeps it. Firmware remembers one rate: (rate + rate_before)/2.

    `rate_dps` (n,) are at the samples.
    """
    midpoint = np.array(rate_dps, dtype=np.float64)
    midpoint[1:] += rate_dps[:-1]
    midpoint[1:] *= 0.5
    return midpoint


def _check(name: str, value: float, allowed: bool) -> None:
    if not (allowed and math.isfinite(value)):
        raise ValueError(f"no filter can be tuned from a {name} of {value}")
