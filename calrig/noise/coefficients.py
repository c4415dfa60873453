"""The noise coefficients of IEEE Std 952-1997 from an Allan curve, no more of them than it asks for.

σ²(τ) = 3Q²/τ² + N²/τ + (2/π)·ln 2·B² + K²τ/3 + R²τ²/2 (annex C; the paper's Table 1). The paper's equation 3
places π otherwise; as here, the flicker's floor is 0.664·B, which is what the standard and data sheets mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.noise.allan import AllanCurve, IntArray
from calrig.noise.allan_fit import RAMP, CurveData, CurveFits, fit_curve
from calrig.noise.allan_theory import KINDS, theory_of

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
class Coefficient:
    """A coefficient with its standard uncertainty, and the unit of both, such as `g·√s`."""

    value: float
    std: float
    unit: str


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
    """The coefficients that a curve asks for.

    A steady ramp is no noise: it is the slope of the log, where the noise would hardly leave one as steep.

    Args:
        curve: of one channel.
        unit: of the channel, as a person writes it.
        lines: frequency in Hz and amplitude of spectral lines; what they add to the curve is taken off it.
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
    """Fits of the octaves `used`, and of which of them.

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
    """The terms of the best fit that no other combination contests."""
    best, scatter = found.best, math.sqrt(found.excess)
    values = [*np.sqrt(best.c), abs(slope_per_s)]
    stds = [*(0.5 * np.sqrt(best.c * np.diag(best.relative)) * scatter), best.slope_std * scatter]
    named: dict[str, Coefficient] = {}
    unclear: set[int] = set()
    for place, term in enumerate(best.terms):
        rivals = found.rivals(term)
        if rivals is None and (steady or term != RAMP):
            named[TERMS[term]] = Coefficient(float(values[place]), float(stds[place]), unit + UNITS[term])
        elif rivals and steady:
            unclear |= {term, *rivals}
    contested = tuple(TERMS[term] for term in sorted(unclear))
    return Coefficients(**named, unclear=contested, explained_s=explained_s)


def _bare_ramp(curve: AllanCurve, unit: str) -> Coefficient | None:
    """The slope of a log without noise, unless it is the arithmetic's."""
    std = math.sqrt(72.0) * curve.rounding * (curve.rate_hz / float(curve.lengths.max())) ** 2
    size = abs(curve.slope_per_s)
    return Coefficient(size, float(std), unit + UNITS[RAMP]) if size > 10.0 * std else None


def _of_lines(curve: AllanCurve, lines: Sequence[tuple[float, float]]) -> FloatArray:
    """(M,) Allan variance of sinusoids: A²·sin⁴(πfτ)/(m·sin(πfτ₀))²."""
    total = np.zeros(len(curve.tau_s))
    for frequency_hz, amplitude in lines:
        edge = curve.factors * math.sin(math.pi * frequency_hz / curve.rate_hz)
        total += (amplitude * np.sin(math.pi * frequency_hz * curve.tau_s) ** 2 / edge) ** 2
    return total
