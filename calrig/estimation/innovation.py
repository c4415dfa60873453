"""Does the filter's noise fit the data? Its innovation tells, over a segment in which the sensor stands.

Where what the filter assumes is so, the innovations y = z − predicted are white with the variance S that the
filter itself states: y²/S is chi-square distributed (Bar-Shalom, Li & Kirubarajan, Estimation with
Applications to Tracking and Navigation, 2001, section 5.4), and no lag's autocorrelation differs from 0
(Mehra, IEEE Trans. Autom. Control 15 (1970) 175; portmanteau of Ljung & Box, Biometrika 65 (1978) 297).

A chip that low-passes its samples makes neighbours alike: their innovations are then not white and vary less
than S, rightly, for R stands for the density at low frequency. So the same is asked of means over 100 ms,
where the filter acts and the chip's low-pass no longer shows.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calrig.estimation.angles import FloatArray, wrap_deg
from calrig.estimation.gains import filter_uniform, gain_schedule
from calrig.estimation.kalman import KalmanNoise

Verdict = Literal["consistent", "low_passed", "varies_more", "varies_less", "correlated", "too_short"]

BLOCK_S = 0.1
MAX_LAGS = 20
MIN_VALUES = 20
SIGNIFICANCE = 0.01 / 4
"""Of each of the four tests, so that a filter that fits is found wanting in 1 % of logs."""
VARIANCE_TOLERANCE = 0.15
"""Within this a variance is called right, however surely it differs: Allan coefficients are known to some
percent, and R goes with their square."""
CORRELATION_TOLERANCE = 0.05
"""Likewise for the largest autocorrelation."""
FAR_OFF = 1.5
"""A variance off by more than this factor is said first: correlation then follows from the wrong gains."""


@dataclass(frozen=True, slots=True)
class Whiteness:
    """The tests of one series of normalised innovations.

    Attributes:
        variance_ratio: mean of y²/S; 1 where the filter's noise is the data's.
        variance_p_value: two-sided, of n·variance_ratio as chi-square with n degrees of freedom, less what
            the values' own correlation takes: n/(1 + 2·Σρ²).
        lags: how many autocorrelations enter the portmanteau: a fifth of n, at most `MAX_LAGS`.
        first_correlation: at lag 1.
        largest_correlation: the one of greatest magnitude, signed.
        white_p_value: of the portmanteau.
    """

    n: int
    variance_ratio: float
    variance_p_value: float
    lags: int
    first_correlation: float
    largest_correlation: float
    white_p_value: float

    @property
    def right_variance(self) -> bool:
        """As assumed, by the test or within `VARIANCE_TOLERANCE`."""
        return self.variance_p_value >= SIGNIFICANCE or abs(self.variance_ratio - 1.0) <= VARIANCE_TOLERANCE

    @property
    def white(self) -> bool:
        """White, by the test or within `CORRELATION_TOLERANCE`."""
        return self.white_p_value >= SIGNIFICANCE or abs(self.largest_correlation) <= CORRELATION_TOLERANCE


@dataclass(frozen=True, slots=True)
class InnovationCheck:
    """Whether the filter's noise fits: a verdict, one sentence, and the figures behind it.

    Attributes:
        verdict: `consistent`; `low_passed` (neighbouring samples alike, right over 100 ms); `varies_more`,
            `varies_less` (than the filter assumes); `correlated`; `too_short`.
        per_sample: tests of the innovations themselves; None if too short.
        per_block: tests of their means over `BLOCK_S`; None if too short.
    """

    verdict: Verdict
    sentence: str
    per_sample: Whiteness | None
    per_block: Whiteness | None


def innovation_check(
    elevation_deg: FloatArray, rate_dps: FloatArray, dt_s: float, noise: KalmanNoise | None = None
) -> InnovationCheck:
    """Run the filter over a static interval and test its innovations, per sample and over 100 ms.

    `elevation_deg` (n,) is of the accelerometer while nothing turns, evenly sampled; `rate_dps` (n,) is as
    the filter is driven by it, which assumes `noise`.

    Raises:
        ValueError: as `filter_uniform`.
    """
    normalised = normalised_innovations(elevation_deg, rate_dps, dt_s, noise)
    size = max(1, round(BLOCK_S / dt_s))
    blocks = len(normalised) // size
    means = normalised[: blocks * size].reshape(blocks, size).mean(axis=1) * math.sqrt(size)
    per_sample, per_block = _whiteness(normalised), _whiteness(means)
    verdict, sentence = _judge(per_sample, per_block)
    return InnovationCheck(verdict, sentence, per_sample, per_block)


def normalised_innovations(
    elevation_deg: FloatArray, rate_dps: FloatArray, dt_s: float, noise: KalmanNoise | None = None
) -> FloatArray:
    """y/√S of every sample but the first, (n − 1,), from what the filter gives out.

    z − angle = (1 − k)·y and S = R/(1 − k), k being the gain of the angle at that sample, start included.
    """
    noise = noise or KalmanNoise()
    filtered = filter_uniform(elevation_deg, rate_dps, dt_s, noise)
    k_angle, _ = gain_schedule(noise, dt_s, len(filtered))
    left = wrap_deg(np.asarray(elevation_deg - filtered, dtype=np.float64))
    return np.asarray(left[1:] / np.sqrt((1.0 - k_angle[1:]) * noise.r_deg2), dtype=np.float64)


def _whiteness(y: FloatArray) -> Whiteness | None:
    from scipy.special import chdtr, chdtrc

    n = len(y)
    if n < MIN_VALUES:
        return None
    lags, power = min(MAX_LAGS, n // 5), float(y @ y)
    if power == 0.0:
        return Whiteness(n, 0.0, 0.0, lags, 0.0, 0.0, 1.0)
    rho = np.array([float(y[lag:] @ y[:-lag]) for lag in range(1, lags + 1)]) / power
    portmanteau = n * (n + 2.0) * float(np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    # 1/n is what ρ² amounts to by chance
    dof = n / (1.0 + 2.0 * float(np.sum(np.maximum(rho**2 - 1.0 / n, 0.0))))
    statistic = power / n * dof
    tail = min(float(chdtr(dof, statistic)), float(chdtrc(dof, statistic)))
    return Whiteness(
        n=n,
        variance_ratio=power / n,
        variance_p_value=min(1.0, 2.0 * tail),
        lags=lags,
        first_correlation=float(rho[0]),
        largest_correlation=float(rho[np.argmax(np.abs(rho))]),
        white_p_value=float(chdtrc(lags, portmanteau)),
    )


def _judge(sample: Whiteness | None, block: Whiteness | None) -> tuple[Verdict, str]:
    if sample is None or block is None:
        return "too_short", f"Too short to judge the filter: {MIN_VALUES * BLOCK_S:g} s at rest are needed."
    # a low-pass makes the nearest the most alike; a tone comes round again
    alike = not sample.white and 0.0 < sample.first_correlation == sample.largest_correlation
    # beyond a chip's low-pass the filter is judged by what it lives by: the density at low frequency
    variance = block if alike else sample
    ratio, p_value = variance.variance_ratio, variance.variance_p_value
    how_correlated = (
        f"over 100 ms it is correlated ({block.largest_correlation:+.2f}, p {block.white_p_value:.2g})"
    )
    far_off = not variance.right_variance and abs(math.log(max(ratio, 1e-9))) > math.log(FAR_OFF)
    if not block.white and not far_off:
        why = (
            "something moves more slowly or more regularly than its noise says"
            if block.first_correlation > 0.0
            else "it follows the noise too eagerly, or a tone is in it"
        )
        return "correlated", f"The innovation is not the filter's: {how_correlated}; {why}."
    if not variance.right_variance:
        verdict: Verdict = "varies_more" if ratio > 1.0 else "varies_less"
        besides = "" if block.white else f", and {how_correlated}"
        return verdict, (
            f"The innovation varies {'more' if ratio > 1.0 else 'less'} than the filter assumes, {ratio:.2f} "
            f"times its variance (p {p_value:.2g}){besides}: the filter's noise is not this unit's."
        )
    if alike:
        return "low_passed", (
            f"From sample to sample the innovation is coloured ({sample.first_correlation:+.2f}, variance "
            f"{sample.variance_ratio:.2f}), as a chip's low-pass makes it; over 100 ms it is white and its "
            f"variance {ratio:.2f} times what the filter assumes: the filter fits where it acts."
        )
    if not sample.white:
        return "correlated", (
            f"The innovation is correlated from sample to sample ({sample.largest_correlation:+.2f}, p "
            f"{sample.white_p_value:.2g}), not as a low-pass would make it: a tone or the filter's own gain "
            "is in it."
        )
    return "consistent", (
        f"The innovation is white (p {sample.white_p_value:.2g}) and its variance {ratio:.2f} times what the "
        f"filter assumes (p {p_value:.2g}): the filter's noise is this unit's."
    )
