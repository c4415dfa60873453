"""A dwell's reading: the mean of its filtered samples, and what that mean is worth."""

import math
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.estimation.autoregressive import MIN_SAMPLES, fit_autoregression
from calrig.estimation.gains import SteadyStateGain, steady_state_gain
from calrig.estimation.kalman import KalmanNoise


@dataclass(frozen=True, slots=True)
class Reading:
    """What one dwell gives.

    Attributes:
        reading_deg: mean of the filtered samples, in (−180, 180].
        reading_std_deg: their spread (n − 1); None for one sample.
        reading_stderr_deg: standard error of the mean; None below `MIN_SAMPLES` samples.
    """

    reading_deg: float
    reading_std_deg: float | None
    reading_stderr_deg: float | None
    n_samples: int


def dwell_reading(
    time_s: FloatArray,
    elevation_deg: FloatArray,
    rate_dps: FloatArray | None,
    filtered_deg: FloatArray,
    noise: KalmanNoise | None = None,
) -> Reading:
    """Read a dwell.

    Args:
        time_s: (n,) the board's clock over the dwell.
        elevation_deg: (n,) elevation of the accelerometer, as it went into the filter.
        rate_dps: (n,) angular rate, as it went into the filter; None where the board has filtered and sends
            the angle alone.
        filtered_deg: (n,) what the filter gave, continuous.
        noise: what the filter assumes.

    Raises:
        ValueError: no sample, or shapes that differ.
    """
    n = len(filtered_deg)
    rates = n if rate_dps is None else len(rate_dps)
    if n == 0 or not len(time_s) == len(elevation_deg) == rates == n:
        lengths = f"{len(time_s)} times, {len(elevation_deg)} elevations, {rates} rates, {n} filtered"
        raise ValueError(f"a dwell needs samples, as many of each: {lengths}")
    return Reading(
        reading_deg=wrap_deg(float(filtered_deg.mean())),
        reading_std_deg=float(filtered_deg.std(ddof=1)) if n > 1 else None,
        reading_stderr_deg=reading_stderr_deg(time_s, elevation_deg, rate_dps, filtered_deg, noise),
        n_samples=n,
    )


def reading_stderr_deg(
    time_s: FloatArray,
    elevation_deg: FloatArray,
    rate_dps: FloatArray | None,
    filtered_deg: FloatArray,
    noise: KalmanNoise | None = None,
) -> float | None:
    """Return standard error of the mean of a dwell's filtered samples; arguments as for `dwell_reading`.

    The filtered samples are correlated over a good part of a short dwell, so neither std/√n (12 times too
    small) nor their own autocorrelation (biased low) will do. The mean is a linear functional of what went
    into the filter, also before the dwell. With D(ω) the boxcar's response, H the filter's from elevation
    and from rate, S the spectra of their noise:

        variance = (1/2π) ∫ |D(ω)|²·(|H_elevation(ω)|²·S_elevation(ω) + |H_rate(ω)|²·S_rate(ω)) dω

    H is known; S is fitted to the raw samples of the dwell about a straight line, colour included. Noise
    before the dwell is taken to be as in it; noise common to both inputs is not accounted for. It is the
    noise within this dwell: what stays the same all through it (an offset, backlash) it cannot see.

    Where the board filters, what went into its filter is not known, and the long-run variance of its angle
    over n has to do: a guess from below where its filter is slow against the dwell.

    Returns:
        Degrees; None below `MIN_SAMPLES` samples.
    """
    n = len(filtered_deg)
    if n < MIN_SAMPLES:
        return None
    if rate_dps is None:
        return math.sqrt(float(fit_autoregression(filtered_deg).density(np.zeros(1))[0]) / n)
    gain = steady_state_gain(noise or KalmanNoise(), float(np.median(np.diff(time_s))))
    omega, weight = _frequencies(n, gain)
    to_elevation, to_rate = gain.response(omega)
    about_the_filter = wrap_deg(elevation_deg - filtered_deg) + filtered_deg
    density = np.abs(to_elevation) ** 2 * fit_autoregression(about_the_filter).density(omega)
    density += np.abs(to_rate) ** 2 * fit_autoregression(rate_dps).density(omega)
    return math.sqrt(float(weight @ density))


def _frequencies(n: int, gain: SteadyStateGain) -> tuple[FloatArray, FloatArray]:
    """ω at the midpoints of a grid fine enough for dwell and filter, and |D|²·dω/2π, both signs of ω.

    The midpoint rule on N points is exact for what has died out within N samples: the dwell on either side
    and the filter's response, which loses a factor e^(−k_angle/2) a sample or more slowly by its bias.
    """
    points = 1 << math.ceil(math.log2(2 * n + 30.0 / gain.k_angle))
    omega = np.arange(0.5, points // 2, dtype=np.float64) * (2.0 * math.pi / points)
    boxcar = np.sin(omega * (n / 2.0)) / (n * np.sin(omega / 2.0))
    return omega, np.asarray(boxcar**2 * (2.0 / points), dtype=np.float64)
