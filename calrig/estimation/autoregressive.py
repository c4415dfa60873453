"""What short segments of coloured noise do at low frequency: an autoregressive spectrum.

A mean feels the noise at frequencies that a short segment has hardly seen. The autocorrelation of its
samples, cut off at some lag, is biased low there; an autoregressive model carries what the short lags say on
to long ones (VARHAC: den Haan & Levin, NBER technical working paper 197, 1996).
"""

import math
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray

MIN_SAMPLES = 8
"""Fewer say nothing about their own correlation."""
_MAX_ORDER = 20


@dataclass(frozen=True, slots=True)
class AutoregressiveSpectrum:
    """Power spectral density σ²/|a₀ + a₁·e^(−iω) + …|², two-sided, per unit of ω/2π.

    Attributes:
        coefficients: (order + 1,) a, with a₀ = 1.
        variance: σ² of the innovation, corrected for what was estimated from the same samples.
    """

    coefficients: FloatArray
    variance: float

    def density(self, omega: FloatArray) -> FloatArray:
        """Return (m,) density at ω radians per sample; at 0 it is the long-run variance."""
        transfer = np.polynomial.polynomial.polyval(np.exp(-1j * omega), self.coefficients)
        return np.asarray(self.variance / np.abs(transfer) ** 2, dtype=np.float64)


def fit_autoregression(x: FloatArray) -> AutoregressiveSpectrum:
    """Return the spectrum of the noise about the straight line through `x`.

    Burg's method (Burg 1975; Kay, Modern Spectral Estimation, 1988, section 7.6), which is always stable,
    with the order of least BIC. The variance is enlarged for the parameters fitted and, since taking out a
    line takes two of them, by n_eff/(n_eff − 2), n_eff = n·(variance/long-run variance) being the number of
    independent samples.

    `x` (n,) are evenly spaced samples, n >= `MIN_SAMPLES`.
    """
    n = len(x)
    if n < MIN_SAMPLES:
        raise ValueError(f"{n} samples say nothing about their correlation; {MIN_SAMPLES} are the least")
    t = np.arange(n) - (n - 1) / 2.0
    x = x - x.mean()
    x = x - t * (t @ x) / (t @ t)
    power = float(x @ x) / n
    if power == 0.0:
        return AutoregressiveSpectrum(np.ones(1), 0.0)
    coefficients, variance = _burg(x, power, min(_MAX_ORDER, n // 4))
    independent = n * power * float(coefficients.sum()) ** 2 / variance
    independent = min(max(independent, 4.0), float(n))
    dof = n - 1 - len(coefficients)
    return AutoregressiveSpectrum(coefficients, variance * n / dof * independent / (independent - 2.0))


def _burg(x: FloatArray, power: float, max_order: int) -> tuple[FloatArray, float]:
    n = len(x)
    forward, backward = x[1:], x[:-1]
    a, variance = np.ones(1), power
    best, least = (a, variance), n * math.log(variance)
    for order in range(1, max_order + 1):
        energy = float(forward @ forward + backward @ backward)
        reflection = -2.0 * float(forward @ backward) / energy if energy > 0.0 else 0.0
        variance *= 1.0 - reflection * reflection
        if variance <= power * np.finfo(np.float64).eps:
            break  # predicted to the last digit: what is left is rounding
        a = np.append(a, 0.0)
        a = a + reflection * a[::-1]
        bic = n * math.log(variance) + order * math.log(n)
        if bic < least:
            best, least = (a, variance), bic
        forward, backward = forward[1:] + reflection * backward[1:], backward[:-1] + reflection * forward[:-1]
    return best
