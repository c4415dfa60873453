"""The noise coefficients of IEEE Std 952-1997 from an Allan curve, and no more of them than it supports.

σ²(τ) = 3Q²/τ² + N²/τ + (2/π)·ln 2·B² + K²τ/3 + R²τ²/2 (annex C; the paper's Table 1). The paper's equation 3
places π otherwise; here the flicker's floor is 0.664·B, as in the standard and in data sheets.

Noise leaves a curve and, at its end, a slope in the log. It has to explain the curve without that slope, and
the slope too unless a ramp does. The variances at octaves of τ are compared on cube roots, which makes a
chi-square variable nearly Gaussian even at the few degrees of freedom of a long τ (Wilson & Hilferty, PNAS
17, 1931), with the covariance that theory gives. Every combination of kinds is fitted, with and without a
ramp; each term must be worth its price.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calrig.estimation.angles import FloatArray, IntArray
from calrig.model.noise import Coefficient
from calrig.noise.allan import KINDS, AllanCurve, CurveTheory, theory_of

RAMP = len(KINDS)
"""The ramp's index, after those of `KINDS`."""
PRICE = 6.0
"""What a term must gain in −2 log likelihood to enter."""
MARGIN = 2.0
"""By how much more than the best every combination without a term must cost, for the term to be named."""
RAMP_MARGIN = 4.0
"""The same for a ramp: a random walk that hardly shows in the curve still moves a log from end to end."""
ITERATIONS = 40
_LARGEST_STEP = 1.0
_SETTLED = 1e-4
_VANISHED = 1e-3
"""Largest share of any value that a kind has where it is as good as not there."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveData:
    """What is fitted.

    Attributes:
        variance: (J,) Allan variances above 0, the slope's part taken off.
        error: (J,) their standard error beyond what theory gives.
    """

    variance: FloatArray
    error: FloatArray
    slope_per_s: float


@dataclass(frozen=True, slots=True, eq=False)
class CurveFit:
    """Noise of p kinds, and perhaps a ramp.

    Attributes:
        terms: indices into `KINDS`, rising; `RAMP` after them if there is one.
        c: (p,) squares of the coefficients of noise.
        relative: (p, p) covariance of log c, by theory.
        slope_std: standard deviation of the slope that the noise leaves.
        criterion: −2 log likelihood.
        misfit: chi-square of the residuals per degree of freedom.
    """

    terms: tuple[int, ...]
    c: FloatArray
    relative: FloatArray
    slope_std: float
    criterion: float
    misfit: float


@dataclass(frozen=True, slots=True, eq=False)
class CurveFits:
    """Every combination of terms that explains a curve, the best first.

    Attributes:
        fits: by cost.
        excess: how many times more than by theory the values vary about the best curve; at least 1.
    """

    fits: tuple[CurveFit, ...]
    excess: float

    @property
    def best(self) -> CurveFit:
        """The combination of least cost."""
        return self.fits[0]

    def rivals(self, term: int) -> tuple[int, ...] | None:
        """What else may stand where the best combination has this term: that of the nearest one without it.

        None where every combination without it is far off; empty where it is as well left out.
        """
        without = [fit for fit in self.fits if term not in fit.terms]
        margin = RAMP_MARGIN if term == RAMP else MARGIN
        if not without or _cost(without[0], self.excess) > _cost(self.best, self.excess) + margin:
            return None
        return tuple(other for other in without[0].terms if other not in self.best.terms)


def fit_curve(data: CurveData, theory: CurveTheory) -> CurveFits | None:
    """Fit every combination of terms; None where none does."""
    sizes = range(1, min(len(KINDS), len(data.variance)) + 1)
    kinds = [chosen for size in sizes for chosen in combinations(range(len(KINDS)), size)]
    tried = [_fit(data, theory, chosen, ramp) for chosen in kinds for ramp in (False, True)]
    fits = [fit for fit in tried if fit is not None]
    if not fits:
        return None
    excess = max(min(fit.misfit for fit in fits), 1.0)
    return CurveFits(tuple(sorted(fits, key=lambda fit: _cost(fit, excess))), excess)


def _cost(fit: CurveFit, excess: float) -> float:
    """−2 log likelihood, as far as the scatter lets it count, and the price of the terms."""
    return fit.criterion / excess + PRICE * len(fit.terms)


def _fit(data: CurveData, theory: CurveTheory, kinds: tuple[int, ...], ramp: bool) -> CurveFit | None:
    """Fit log c; None where a kind vanishes, since the combination without it is another."""
    values, columns = data.variance, theory.variance[:, kinds]
    if not ramp:
        values = np.append(values, data.slope_per_s**2)
        columns = np.vstack((columns, theory.slope[list(kinds)]))
    log_c = np.log(np.min(data.variance[:, None] / theory.variance[:, kinds], axis=0))
    for _ in range(ITERATIONS):
        c = np.exp(log_c)
        expected = columns @ c
        covariance = np.diag(2.0 * expected**2)  # a square of one value has one degree of freedom
        j = len(data.variance)
        covariance[:j, :j] = theory.covariance(list(kinds), c) + np.diag(data.error**2)
        mean, spread, correlation = _cube_root(expected, covariance)
        jacobian = (mean / expected / 3.0 / spread)[:, None] * columns * c
        residual = (np.cbrt(values) - mean) / spread
        weighted = np.linalg.solve(correlation, np.column_stack((jacobian, residual)))
        information = jacobian.T @ weighted[:, :-1]
        step = np.linalg.lstsq(information, jacobian.T @ weighted[:, -1], rcond=1e-12)[0]
        log_c = log_c + np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        if (columns[:j] * np.exp(log_c) / expected[:j, None]).max(axis=0).min() < _VANISHED:
            return None
        if np.abs(step).max() < _SETTLED:
            break
    chi_square = float(residual[:j] @ weighted[:j, -1])
    slope_variance = float(theory.slope[list(kinds)] @ c)
    criterion = chi_square + float(np.linalg.slogdet(correlation)[1]) + 2.0 * float(np.log(spread[:j]).sum())
    steepness = data.slope_per_s**2 / slope_variance
    if (
        ramp
    ):  # of a size not known before: as if drawn from the Gaussian that suits it best, like a walk's slope
        steepness = 1.0 + math.log(max(steepness, 1.0))
    criterion += math.log(slope_variance) + steepness
    return CurveFit(
        terms=(*kinds, RAMP) if ramp else kinds,
        c=np.exp(log_c),
        relative=np.linalg.pinv(information),
        slope_std=math.sqrt(slope_variance),
        criterion=criterion,
        misfit=chi_square / max(j - len(kinds), 1),
    )


def _cube_root(expected: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean, spread and correlation of the cube roots of variances with this mean and covariance."""
    deviation = np.sqrt(np.diag(covariance))
    square = (deviation / expected / 3.0) ** 2  # 2/(9·edf), where edf = 2·mean²/variance
    mean = np.cbrt(expected) * (1.0 - square)
    return mean, np.cbrt(expected) * np.sqrt(square), covariance / np.outer(deviation, deviation)


TERMS = (*KINDS, "ramp")
UNITS = ("·s", "·√s", "", "/√s", "/s")
"""Of the coefficients, after the channel's own."""
MIN_OCTAVES = 4
"""Of τ; fewer do not tell one slope from another."""
MOST_EXCESS = 3.0
"""Scatter about the fitted curve, over what theory says, that is still taken for a sum of these kinds."""
CANCELLED = 1e-10
"""Share of a variance below which the digits are gone once a ramp is taken off."""
MOST_FILTERED = 8
"""Octaves at the short end that may be left out since the sensor's own filter bends the curve there."""
LONGEST_FILTERED_S = 1.0
"""And no longer τ: a low-pass of 1 Hz, as slow as sensors have, is all but done with by then. What rises at
longer τ is a drift, and white noise of its size at long τ would show at short ones."""
LINE_ERROR = 0.2
"""Share of a spectral line's part in a variance that stays uncertain when it is taken off."""


@dataclass(frozen=True, slots=True)
class Coefficients:
    """What an Allan curve is made of; None for what it does not ask for.

    Attributes:
        quantisation: Q, σ = √3·Q/τ, in unit·s.
        white: N, σ = N/√τ, in unit·√s; angle or velocity random walk. One-sided density is √2·N.
        flicker: B, σ = 0.664·B, in the unit; bias instability.
        random_walk: K, σ = K·√(τ/3), in unit/√s; rate random walk.
        ramp: R, σ = R·τ/√2, in unit/s; its size, without its sign.
        unclear: kinds that something in the curve may be, and that are indistinguishable in these data.
        explained_s: first and last τ that these explain; short ones are left out where a filter bends the
            curve, long ones where something drifts that is neither noise nor a ramp. None without a fit.
    """

    quantisation: Coefficient | None = None
    white: Coefficient | None = None
    flicker: Coefficient | None = None
    random_walk: Coefficient | None = None
    ramp: Coefficient | None = None
    unclear: tuple[str, ...] = ()
    explained_s: tuple[float, float] | None = None


def coefficients(curve: AllanCurve, unit: str, lines: Sequence[tuple[float, float]] = ()) -> Coefficients:
    """Return the coefficients that a curve asks for.

    A steady ramp is no noise: it is the slope of the log, where the noise would hardly leave one as steep.

    `unit` is of the channel, as a person writes it; `lines` are frequency in Hz and amplitude of spectral
    lines; what they add to the curve is taken off it.
    """
    octaves = np.flatnonzero((curve.factors & (curve.factors - 1)) == 0)
    if len(octaves) < MIN_OCTAVES:
        return Coefficients()
    slope = curve.slope_per_s
    level = curve.deviation**2 - slope * curve.tau_s * curve.mean_step + 0.5 * (slope * curve.tau_s) ** 2
    rounding = 50.0 * (curve.rounding / curve.tau_s) ** 2 + CANCELLED * curve.deviation**2
    used = octaves[level[octaves] > rounding[octaves]]
    if len(used) < MIN_OCTAVES:
        return Coefficients(ramp=_bare_ramp(curve, unit))
    by_lines = _of_lines(curve, lines)
    level = np.maximum(level - by_lines, LINE_ERROR * np.minimum(level, by_lines))
    found, explained = _fits(curve, used, level, LINE_ERROR * by_lines)
    if found is None:
        return Coefficients()
    first, last = curve.tau_s[explained[[0, -1]]]
    steady = bool(explained[-1] == used[-1])
    return _named(found, slope, unit, (float(first), float(last)), steady=steady)


def _fits(
    curve: AllanCurve, used: IntArray, level: FloatArray, error: FloatArray
) -> tuple[CurveFits | None, IntArray]:
    """Fit the octaves `used`; return the fits and which of them were fitted.

    Where no sum of these kinds explains them all, as few as it takes are left out: short ones, which the
    sensor's own filter bends, or long ones, where something drifts that is neither noise nor a steady ramp.
    """

    def fits(rest: IntArray, *, filtered: bool) -> CurveFits | None:
        data = CurveData(level[rest], error[rest], curve.slope_per_s)
        found = fit_curve(data, theory_of(curve, rest, filtered=filtered))
        return found if found is not None and found.excess <= MOST_EXCESS else None

    if whole := fits(used, filtered=False):
        return whole, used
    filterable = min(MOST_FILTERED, int((curve.tau_s[used] < LONGEST_FILTERED_S).sum()))
    for dropped in range(1, len(used) - MIN_OCTAVES + 1):
        if dropped <= filterable and fits(used[dropped:], filtered=True):
            further = used[min(dropped + 1, len(used) - MIN_OCTAVES) :]  # a filter reaches on unseen
            return fits(further, filtered=True), further
        if short := fits(used[:-dropped], filtered=False):
            return short, used[:-dropped]
    return None, used[:0]


def _named(
    found: CurveFits, slope_per_s: float, unit: str, explained_s: tuple[float, float], *, steady: bool
) -> Coefficients:
    """Return the terms of the best fit that no other combination contests."""
    best, scatter = found.best, math.sqrt(found.excess)
    values = [*np.sqrt(best.c), abs(slope_per_s)]
    stds = [*(0.5 * np.sqrt(best.c * np.diag(best.relative)) * scatter), best.slope_std * scatter]
    named: dict[str, Coefficient] = {}
    unclear: set[int] = set()
    for place, term in enumerate(best.terms):
        rivals = found.rivals(term)
        if rivals is None and (steady or term != RAMP):
            value, std = float(values[place]), float(stds[place])
            named[TERMS[term]] = Coefficient(value=value, std=std, unit=unit + UNITS[term])
        elif rivals and steady:
            unclear |= {term, *rivals}
    contested = tuple(TERMS[term] for term in sorted(unclear))
    return Coefficients(**named, unclear=contested, explained_s=explained_s)


def _bare_ramp(curve: AllanCurve, unit: str) -> Coefficient | None:
    """Return the slope of a log without noise, unless it is the arithmetic's."""
    std = math.sqrt(72.0) * curve.rounding * (curve.rate_hz / float(curve.lengths.max())) ** 2
    size = abs(curve.slope_per_s)
    is_real = size > 10.0 * std
    return Coefficient(value=size, std=float(std), unit=unit + UNITS[RAMP]) if is_real else None


def _of_lines(curve: AllanCurve, lines: Sequence[tuple[float, float]]) -> FloatArray:
    """Return (M,) Allan variance of sinusoids: A²·sin⁴(πfτ)/(m·sin(πfτ₀))²."""
    total = np.zeros(len(curve.tau_s))
    for frequency_hz, amplitude in lines:
        edge = curve.factors * math.sin(math.pi * frequency_hz / curve.rate_hz)
        total += (amplitude * np.sin(math.pi * frequency_hz * curve.tau_s) ** 2 / edge) ** 2
    return total
