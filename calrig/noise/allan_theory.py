"""What theory says of an overlapping Allan variance: its size for each kind of noise, and how it scatters.

Values at neighbouring τ rest on the same samples, so they err together. The differences at a factor m are
the samples passed through a filter; with G_i(ν) their spectrum, ν in cycles a sample, the covariance of two
values is ∫ G_i·G_j dν from 0 to 1/2 over the number of differences (mean squares of Gaussian series: Percival
& Walden, Wavelet Methods for Time Series Analysis, 2000, section 8.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.noise.allan import AllanCurve, IntArray

KINDS = ("quantisation", "white", "flicker", "random_walk")
"""Noise of variance 3Q²/τ², N²/τ, (2/π)·ln 2·B², K²τ/3 (IEEE Std 952-1997, annex C)."""
RAGGED = np.array([0.0, 0.0, 0.25, 0.5])
"""Share by which a kind may miss that at one sample, by how the sensor filters before it samples; it falls as
1/m². A sum of independent steps has 0.5 too much, 1/f noise without a filter 0.2."""
FILTERED = np.array([0.0, 2.0, 0.0, 0.0])
"""Share by which a filter makes white noise miss it at the shortest τ that is still of use."""
MISFIT = 0.005
"""Share of a variance by which no sensor is as simple as a sum of these."""
_FREQUENCIES = 4096


@dataclass(frozen=True, slots=True, eq=False)
class CurveTheory:
    """Theory of J values of a curve, the log's slope taken off, where Q², N², B², K² are c.

    Attributes:
        variance: (J, 4) Allan variance per unit of each c.
        products: (4, 4, J, J) covariance of the values per unit of each product of two c.
        ragged: (J, 4) how far the sensor's own filter may take `variance` astray.
        slope: (4,) variance of the curve's `slope_per_s` per unit of each c.
    """

    variance: FloatArray
    products: FloatArray
    ragged: FloatArray
    slope: FloatArray

    def covariance(self, kinds: list[int], c: FloatArray) -> FloatArray:
        """(J, J) covariance of the values, for noise of the given kinds with c (p,)."""
        among = self.products[np.ix_(kinds, kinds)]
        ragged = self.ragged[:, kinds] * c
        misfit = (MISFIT * (self.variance[:, kinds] @ c)) ** 2 + (ragged**2).sum(axis=1)
        total = np.einsum("k,l,klij->ij", c, c, among) + ragged @ ragged.T + np.diag(misfit)
        return np.asarray(total, dtype=np.float64)


def variance_of(tau_s: FloatArray) -> FloatArray:
    """(J, 4) Allan variance at τ per unit of Q², N², B², K²."""
    flat = np.full(len(tau_s), 2.0 * math.log(2.0) / math.pi)
    return np.column_stack([3.0 / tau_s**2, 1.0 / tau_s, flat, tau_s / 3.0])


def theory_of(curve: AllanCurve, used: IntArray, *, filtered: bool = False) -> CurveTheory:
    """The theory of a curve's values.

    Args:
        curve: of one channel.
        used: (J,) which of its values, τ rising.
        filtered: whether the sensor's filter still bends white noise at the first of them; it falls as 1/m.
    """
    tau_s, factors = curve.tau_s[used], curve.factors[used].astype(np.float64)
    variance = variance_of(tau_s)
    log_nu = np.linspace(math.log(0.02 / curve.lengths.max()), math.log(0.5), _FREQUENCIES)
    nu = np.exp(log_nu)
    width = nu * (log_nu[1] - log_nu[0])
    density = _densities(nu, 1.0 / curve.rate_hz)
    transfer = 2.0 * np.sin(math.pi * np.outer(factors, nu)) ** 2 / np.outer(factors, np.sin(math.pi * nu))
    spectra = density[:, None, :] * transfer**2
    differences = _differences(curve.lengths, factors)
    products = np.einsum("kif,ljf->klij", spectra * width, spectra, optimize=True)
    slope = _slope_variance(curve.lengths / curve.rate_hz)
    common = _slope_with_steps(curve, factors, transfer, nu) @ (density * width).T
    kept = 1.0 - (tau_s[:, None] * common - 0.5 * np.outer(tau_s**2, slope)) / variance
    products *= kept.T[:, None, :, None] * kept.T[None, :, None, :]
    products /= np.sqrt(np.outer(differences, differences))
    products[0, 0] += 0.5 * np.outer(tau_s, tau_s) ** 2 * slope[0] ** 2  # all that scatters where τ is long
    return CurveTheory(
        variance=variance * kept,
        products=products,
        ragged=variance
        * (RAGGED / factors[:, None] ** 2 + filtered * np.outer(factors[0] / factors, FILTERED)),
        slope=slope,
    )


def _differences(lengths: IntArray, factors: FloatArray) -> FloatArray:
    """(J,) how many differences there are; the few that fit where τ is long count for more each."""
    inside = np.maximum(lengths - 2.0 * factors[:, None] + 1.0, 0.8 * factors[:, None])
    return np.asarray(np.where(2 * factors[:, None] <= lengths, inside, 0.0).sum(axis=1), dtype=np.float64)


def _densities(nu: FloatArray, period_s: float) -> FloatArray:
    """(4, F) two-sided density per cycle a sample of each kind of noise, per unit of its c."""
    edge = 2.0 * np.sin(math.pi * nu)
    flat = np.full(len(nu), 1.0 / period_s)
    return np.stack([(edge / period_s) ** 2, flat, 0.5 / (math.pi * nu), period_s / edge**2])


def _slope_variance(durations_s: FloatArray) -> FloatArray:
    """(4,) variance of the pooled slope of straight lines through segments, per unit of each c.

    Each is ∫ S(f)·|W(f)|² df, with W the transform of the line's weights 12t/T³.
    """
    alone = np.stack(
        [72.0 / durations_s**4, 12.0 / durations_s**3, 9.0 / (math.pi * durations_s**2), 1.2 / durations_s]
    )
    weight = durations_s**3 / (durations_s**3).sum()
    return np.asarray(alone @ weight**2, dtype=np.float64)


def _slope_with_steps(
    curve: AllanCurve, factors: FloatArray, transfer: FloatArray, nu: FloatArray
) -> FloatArray:
    """(J, F) what a density must be multiplied by for the covariance of `slope_per_s` and `mean_step`.

    Segments count as so many of equal length as give the slope the same weight.
    """
    cubes = curve.lengths.astype(np.float64) ** 3
    segments = cubes.sum() ** 2 / (cubes**2).sum()
    length = (cubes.sum() / segments) ** (1.0 / 3.0)
    turns = math.pi * length * nu
    slope = 12.0 / length * (np.sin(turns) / (2.0 * turns**2) - np.cos(turns) / (2.0 * turns)) * curve.rate_hz
    places = np.maximum(length - 2.0 * factors[:, None] + 1.0, 1.0)
    steps = transfer * np.sin(math.pi * places * nu) / (places * np.sin(math.pi * nu))
    return np.asarray(2.0 / segments * slope * steps, dtype=np.float64)
