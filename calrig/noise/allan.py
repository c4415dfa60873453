"""Overlapping Allan deviation with confidence limits, and the theory of its size and scatter.

The Allan variance at τ = m·τ₀ is half the mean square of the difference between neighbouring averages of m
samples, taken at every place where the two fit (NIST SP 1065, equation 11; IEEE Std 952-1997, annex C). With
the phase x, the running sum of the N samples from x₀ = 0,

    σ²(m·τ₀) = 1/(2·m²·(N + 1 − 2m)) · Σ (x[i+2m] − 2·x[i+m] + x[i])²     i = 0 … N − 2m

No difference reaches across a gap: the sum runs over the segments, their number of differences replaces
N + 1 − 2m, and τ ends at half the longest segment. The limits follow from edf·σ̂²/σ² being chi-square
distributed (SP 1065, equations 45 and 46), with the degrees of freedom edf of the kind of noise at that τ
(table 5), added up over the segments. The paper's equation 4 divides by 2s − 1 instead of the number of
differences; this module follows the standard.

Values at neighbouring τ rest on the same samples, so they err together. The differences at a factor m are the
samples passed through a filter of spectrum G_i(ν), ν in cycles a sample; the covariance of two values is
∫ G_i·G_j dν from 0 to 1/2 over the number of differences (Percival & Walden, Wavelet Methods for Time Series
Analysis, 2000, section 8.3).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from calrig.estimation.angles import FloatArray, IntArray
from calrig.noise.resampling import UniformLog

CONFIDENCE = 0.6827
"""Share of logs whose true deviation lies within the limits: one sigma, as the field draws them."""
POINTS_PER_OCTAVE = 4
MIN_CLUSTERS = 4
"""A log of fewer averages of length τ says nothing there (Stable32's stop ratio for this deviation)."""
_BLOCK = 32_768
"""Differences taken at a time: few enough that they stay in the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Overlapping Allan deviation of one channel.

    Attributes:
        tau_s: (M,) averaging times in s from one sample on, four an octave and 1 s with its decades; none
            that the log is too short for.
        deviation, low, high: (M,) in the channel's unit, and the limits of `CONFIDENCE`.
        n_clusters: (M,) how many averages of length τ lie end to end in the log.
        factors: (M,) τ in samples.
        lengths: (S,) samples of each segment.
        mean_step: (M,) mean difference, with its sign, of neighbouring averages; a steady ramp leaves R·τ.
        slope_per_s: slope of the straight line through the samples of a segment, in unit/s, pooled over the
            segments with their length³ for weight.
        rounding: spread, in unit·s, that double precision alone leaves in the running sum.
    """

    tau_s: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray
    n_clusters: IntArray
    rate_hz: float
    factors: IntArray
    lengths: IntArray
    mean_step: FloatArray
    slope_per_s: float
    rounding: float

    @property
    def adf_slope(self) -> float | None:
        """Slope of log σ over log τ from one sample to 1 s; None with fewer than three values there."""
        used = (self.tau_s <= 1.0 + 1e-9) & (self.deviation > 0.0)
        if used.sum() < 3:
            return None
        return float(np.polyfit(np.log(self.tau_s[used]), np.log(self.deviation[used]), 1)[0])


def allan_curve(log: UniformLog, name: str) -> AllanCurve:
    """Return the overlapping Allan deviation of a channel.

    `log` has evenly spaced samples, `name` is one of its channels.
    """
    pieces = [log.channels[name][segment] for segment in log.segments]
    pieces = [piece for piece in pieces if len(piece) >= 2]
    lengths = np.array([len(piece) for piece in pieces], dtype=np.int64)
    factors = _factors(lengths, log.rate_hz)
    squares, steps, counts = (np.zeros(len(factors)) for _ in range(3))
    slope, weight, rounding = 0.0, 0.0, 0.0
    for piece in pieces:
        phase = _phase(piece)
        fitting = factors[2 * factors <= len(piece)]
        used = slice(len(fitting))
        counts[used] += len(phase) - 2 * fitting
        squares[used] += [_sum_of_squares(phase, int(m)) / float(m) ** 2 for m in fitting]
        steps[used] += _sums_of_differences(phase, fitting)
        slope += _slope(phase) * len(piece) ** 3
        weight += float(len(piece)) ** 3
        rounding = max(rounding, float(np.abs(phase).max() * np.sqrt(len(piece))) * np.finfo(np.float64).eps)
    variance = squares / np.maximum(counts, 1.0) / 2.0
    low, high = _limits(variance, _edf(factors, lengths, _exponents(factors, variance)))
    return AllanCurve(
        tau_s=factors / log.rate_hz,
        deviation=np.sqrt(variance),
        low=low,
        high=high,
        n_clusters=_clusters(factors, lengths),
        rate_hz=log.rate_hz,
        factors=factors,
        lengths=lengths,
        mean_step=steps / np.maximum(counts, 1.0) / factors,
        slope_per_s=slope / weight * log.rate_hz if weight else 0.0,
        rounding=rounding / log.rate_hz,
    )


def _factors(lengths: IntArray, rate_hz: float) -> IntArray:
    """Averaging factors that the segments are long enough for; 1 s and its decades are among them."""
    if not len(lengths):
        return np.zeros(0, dtype=np.int64)
    steps = np.arange(np.log2(lengths.max()) * POINTS_PER_OCTAVE)
    decades = rate_hz * 10.0 ** np.arange(-3.0, 6.0)
    wanted = np.concatenate((2.0 ** (steps / POINTS_PER_OCTAVE), decades[decades >= 1.0]))
    factors = np.unique(np.rint(wanted).astype(np.int64))
    return factors[_clusters(factors, lengths) >= MIN_CLUSTERS]


def _clusters(factors: IntArray, lengths: IntArray) -> IntArray:
    whole = lengths // factors[:, None]
    return np.asarray(np.where(whole >= 2, whole, 0).sum(axis=1), dtype=np.int64)


def _phase(values: FloatArray) -> FloatArray:
    """Return (n + 1,) running sum about the mean, from 0; about the mean, since that keeps its digits."""
    phase = np.empty(len(values) + 1)
    phase[0] = 0.0
    np.subtract(values, values.mean(), out=phase[1:])
    np.cumsum(phase[1:], out=phase[1:])
    return phase


def _sum_of_squares(phase: FloatArray, m: int) -> float:
    """Σ (x[i+2m] − 2x[i+m] + x[i])²."""
    first, middle, last = phase[: -2 * m], phase[m:-m], phase[2 * m :]
    total = 0.0
    for start in range(0, len(first), _BLOCK):
        part = slice(start, start + _BLOCK)
        difference = last[part] - middle[part]
        difference -= middle[part]
        difference += first[part]
        total += float(difference @ difference)
    return total


def _sums_of_differences(phase: FloatArray, factors: IntArray) -> FloatArray:
    """Return (M,) Σ (x[i+2m] − 2x[i+m] + x[i]), of which all but the ends cancels."""
    running = np.cumsum(phase)
    first, middle = running[factors - 1], running[2 * factors - 1]
    last, before = running[-1] - running[-1 - factors], running[-1] - running[-1 - 2 * factors]
    return np.asarray((last - (before - last)) - ((middle - first) - first), dtype=np.float64)


def _slope(phase: FloatArray) -> float:
    """Least-squares slope per sample of the values whose running sum this is."""
    n = len(phase) - 1
    moment = 0.5 * (n + 1) * phase[-1] - phase[1:].sum()
    return float(12.0 * moment / (n * (float(n) ** 2 - 1.0)))


def _exponents(factors: IntArray, variance: FloatArray) -> IntArray:
    """Return (M,) α of the density f^α that the variance's slope over two octaves tells of: 2, 0, −1 or −2.

    What falls slower with τ outlasts what falls faster, so α never rises again.
    """
    known = variance > 0.0
    if known.sum() < 2:
        return np.zeros(len(factors), dtype=np.int64)
    octave, log_variance = np.log2(factors), np.log2(variance, where=known, out=np.zeros(len(factors)))
    above = np.interp(octave + 1.0, octave[known], log_variance[known])
    below = np.interp(octave - 1.0, octave[known], log_variance[known])
    width = np.minimum(octave + 1.0, octave[known][-1]) - np.maximum(octave - 1.0, octave[known][0])
    slope = (above - below) / np.maximum(width, 1e-9)
    alpha = np.select([slope < -1.5, slope < -0.5, slope < 0.5], [2, 0, -1], -2)
    return np.asarray(np.minimum.accumulate(alpha), dtype=np.int64)


def _edf(factors: IntArray, lengths: IntArray, exponents: IntArray) -> FloatArray:
    """Return (M,) equivalent degrees of freedom (NIST SP 1065, table 5), summed over the segments."""
    edf = np.zeros(len(factors))
    sizes, how_many = np.unique(lengths, return_counts=True)
    for size, times in zip(sizes, how_many, strict=True):
        used = 2 * factors <= size
        n, m, alpha = size + 1.0, factors[used].astype(np.float64), exponents[used]
        white_phase = (n + 1.0) * (n - 2.0 * m) / (2.0 * (n - m))
        white = (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
        flicker = np.where(
            m == 1.0, 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9), 1.25 * n**2 / (m * (n + 3.0 * m))
        )
        walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / max(n - 3.0, 1.0) ** 2
        edf[used] += times * np.select(
            [alpha == 2, alpha == 0, alpha == -1], [white_phase, white, flicker], walk
        )
    return np.maximum(edf, 1.0)


def _limits(variance: FloatArray, edf: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Limits of the deviation: edf·σ̂²/σ² is chi-square of edf degrees (NIST SP 1065, equations 45 and 46)."""
    tail = (1.0 - CONFIDENCE) / 2.0
    low = np.sqrt(variance * edf / (2.0 * gammaincinv(edf / 2.0, 1.0 - tail)))
    high = np.sqrt(variance * edf / (2.0 * gammaincinv(edf / 2.0, tail)))
    return low, high


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
        """Return (J, J) covariance of the values, for noise of the given kinds with c (p,)."""
        among = self.products[np.ix_(kinds, kinds)]
        ragged = self.ragged[:, kinds] * c
        misfit = (MISFIT * (self.variance[:, kinds] @ c)) ** 2 + (ragged**2).sum(axis=1)
        total = np.einsum("k,l,klij->ij", c, c, among) + ragged @ ragged.T + np.diag(misfit)
        return np.asarray(total, dtype=np.float64)


def variance_of(tau_s: FloatArray) -> FloatArray:
    """Return (J, 4) Allan variance at τ per unit of Q², N², B², K²."""
    flat = np.full(len(tau_s), 2.0 * math.log(2.0) / math.pi)
    return np.column_stack([3.0 / tau_s**2, 1.0 / tau_s, flat, tau_s / 3.0])


def theory_of(curve: AllanCurve, used: IntArray, *, filtered: bool = False) -> CurveTheory:
    """Return the theory of a curve's values.

    `used` (J,) is which of its values, τ rising; `filtered` tells whether the sensor's filter still bends
    white noise at the first of them; it falls as 1/m.
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
    """Return (J,) how many differences there are; the few that fit where τ is long count for more each."""
    inside = np.maximum(lengths - 2.0 * factors[:, None] + 1.0, 0.8 * factors[:, None])
    return np.asarray(np.where(2 * factors[:, None] <= lengths, inside, 0.0).sum(axis=1), dtype=np.float64)


def _densities(nu: FloatArray, period_s: float) -> FloatArray:
    """Return (4, F) two-sided density per cycle a sample of each kind of noise, per unit of its c."""
    edge = 2.0 * np.sin(math.pi * nu)
    flat = np.full(len(nu), 1.0 / period_s)
    return np.stack([(edge / period_s) ** 2, flat, 0.5 / (math.pi * nu), period_s / edge**2])


def _slope_variance(durations_s: FloatArray) -> FloatArray:
    """Return (4,) variance of the pooled slope of straight lines through segments, per unit of each c.

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
    """Return (J, F) what a density must be multiplied by for the covariance of `slope_per_s` and `mean_step`.

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
