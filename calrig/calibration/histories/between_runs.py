"""Compare runs of a unit: changes beyond re-clamping and the day, drift, and components between units.

A false discovery rate decides how many of the units tested together count as changed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from calrig.calibration.histories.repeatability import (
    IntArray,
    Repeatability,
    Runs,
    outlying,
    pairs,
    repeatability,
)
from calrig.estimation.angles import BoolArray, FloatArray

FALSE_DISCOVERY_RATE = 0.05
"""Of the units said to have changed, the share that chance is expected to have marked."""


def rejection_level(p_value: FloatArray) -> float:
    """The p-value up to which hypotheses are rejected of (m,) tests, at `FALSE_DISCOVERY_RATE`; 0 if none is.

    Of m ordered p-values the largest p₍ₖ₎ ≤ rate·k/m, and rate·k/m is given (Benjamini & Hochberg, Journal of
    the Royal Statistical Society B 57, 1995, procedure (1)); it holds for independent tests and for those
    that depend positively.
    """
    m = len(p_value)
    steps = FALSE_DISCOVERY_RATE * np.arange(1, m + 1) / max(m, 1)
    passing = np.flatnonzero(np.sort(p_value) <= steps)
    return float(steps[passing[-1]]) if len(passing) else 0.0


@dataclass(frozen=True, slots=True)
class Differences:
    """Each of K runs less the one before it, of one unit.

    Attributes:
        first, second: (K,) places of the runs.
        value: (K,) difference.
        std: (K,) its standard uncertainty; NaN without a repeatability.
        sigma: (K,) the difference over it; NaN without a repeatability.
        p_value: (K,) two-sided, by Student's t; NaN without a repeatability.
        type_a_std: (K,) its part from the runs' own standard errors.
    """

    first: IntArray
    second: IntArray
    value: FloatArray
    std: FloatArray
    sigma: FloatArray
    p_value: FloatArray
    type_a_std: FloatArray


def differences(runs: Runs, pooled: Repeatability | None) -> Differences:
    """Return each run less the one before it, with the uncertainty by both runs, re-clamping, day and rig.

    u² = u₁² + u₂² + 2·s_run² + 2·s_day² (on another day or rig) + the stages' part (on another rig, the
    larger of what their certificates and what their runs say): GUM, JCGM 100:2008, 5.1.2. Its p-value is
    Student's t with the degrees of freedom of the repeatability, as if all of u² rested on them: on
    the safe side where the runs' own errors are most of it.
    """
    from scipy.special import stdtr

    first, second = pairs(runs.unit)
    value = runs.value[second] - runs.value[first]
    type_a = np.hypot(np.nan_to_num(runs.std[first]), np.nan_to_num(runs.std[second]))
    nothing = np.full(len(first), np.nan)
    if pooled is None:
        return Differences(first, second, value, nothing, nothing, nothing, type_a)
    other_rig = runs.rig[first] != runs.rig[second]
    other_day = runs.day[first] != runs.day[second]
    stages = np.maximum(runs.stage_variance[first] + runs.stage_variance[second], 2.0 * pooled.rig**2)
    variance = type_a**2 + 2.0 * pooled.run**2 + np.where(other_rig, stages, 0.0)
    if pooled.day:
        variance = variance + np.where(other_day | other_rig, 2.0 * pooled.day**2, 0.0)
    std = np.sqrt(variance)
    sigma = np.divide(
        value, std, out=np.where(value == 0.0, 0.0, np.copysign(np.inf, value)), where=std > 0.0
    )
    p_value = 2.0 * stdtr(pooled.freedom, -np.abs(sigma))
    return Differences(first, second, value, std, sigma, p_value, type_a)


@dataclass(frozen=True, slots=True)
class Changes:
    """Changes between consecutive runs, in all figures together.

    Attributes:
        unit: (N,) of the runs, as given.
        figures: the differences of each figure, all of the same K pairs.
        pooled: how each figure repeats; None where the runs do not tell.
        p_value: (K,) of each pair, over its figures; NaN if unknown.
        unit_p_value: (units,) of each unit, over its pairs; NaN if unknown.
        level: what a unit's p-value must not exceed for the unit to count as changed.
        changed: (K,) the pairs that do.
    """

    unit: IntArray
    figures: tuple[Differences, ...]
    pooled: tuple[Repeatability | None, ...]
    p_value: FloatArray
    unit_p_value: FloatArray
    level: float
    changed: BoolArray

    @property
    def first(self) -> IntArray:
        """(K,) places of the earlier runs."""
        return self.figures[0].first


def changes(figures: tuple[Runs, ...], known: tuple[Repeatability | None, ...] | None = None) -> Changes:
    """Return which units changed between which runs.

    A pair's p-value is the least of its figures, times their number; a unit's the least of its pairs, times
    theirs (Bonferroni). Units count as changed up to the level of Benjamini and Hochberg at
    `FALSE_DISCOVERY_RATE`, and of their pairs those that alone would make them count.

    Args:
        figures: the same runs in one figure after the other.
        known: how each figure repeats, by other runs; estimated from these without it.
    """
    first, second = pairs(figures[0].unit)
    apart = np.zeros(len(first), dtype=bool)
    if known is None:
        for runs in figures:
            apart |= _standing_out(runs, first, second)
    pooled = known or tuple(repeatability(runs, second[apart]) for runs in figures)
    found = tuple(differences(*both) for both in zip(figures, pooled, strict=True))
    p_value = _least(np.array([one.p_value for one in found]))
    unit = figures[0].unit[first] if len(first) else np.empty(0, dtype=np.intp)
    of_units = _by_unit(p_value, unit, int(figures[0].unit.max(initial=-1)) + 1)
    level = rejection_level(of_units[np.isfinite(of_units)])
    tests = np.bincount(unit[np.isfinite(p_value)], minlength=len(of_units))
    changed = np.nan_to_num(p_value, nan=1.0) * tests[unit] <= level if level > 0.0 else np.zeros_like(apart)
    return Changes(figures[0].unit, found, pooled, p_value, of_units, level, changed)


def _standing_out(runs: Runs, first: IntArray, second: IntArray) -> BoolArray:
    """(K,) pairs whose difference is none of re-clamping's; those between two rigs say nothing of it."""
    bare = differences(runs, None)
    tested = np.flatnonzero(np.isfinite(bare.value) & (runs.rig[first] == runs.rig[second]))
    out = np.zeros(len(first), dtype=bool)
    out[tested[outlying(bare.value[tested], bare.type_a_std[tested] ** 2)]] = True
    return out


def _least(p_value: FloatArray) -> FloatArray:
    """Bonferroni over the known ones along the first axis; NaN where there is none."""
    known = np.isfinite(p_value)
    least = np.where(known, p_value, np.inf).min(axis=0)
    tests = np.maximum(known.sum(axis=0), 1)
    return np.where(known.any(axis=0), np.minimum(least * tests, 1.0), np.nan)


def _by_unit(p_value: FloatArray, unit: IntArray, units: int) -> FloatArray:
    least = np.full(units, np.inf)
    known = np.isfinite(p_value)
    np.minimum.at(least, unit[known], p_value[known])
    tests = np.bincount(unit[known], minlength=units)
    return np.where(tests > 0, np.minimum(least * np.maximum(tests, 1), 1.0), np.nan)


SHORTEST_DRIFT = timedelta(hours=1)
"""Runs closer than this say nothing of a drift in degrees per day but repeatability, magnified."""
SECONDS_PER_DAY = 86_400.0


@dataclass(frozen=True, slots=True)
class Components:
    """Standard deviations between units and within one; None where the runs do not tell."""

    between: float | None
    within: float | None


def drift_deg_per_day(finished_at: Sequence[datetime], bias_deg: Sequence[float]) -> float | None:
    """Slope of a unit's bias over the day its runs finished, by least squares.

    Args:
        finished_at: when each run finished; all with or all without a time zone.
        bias_deg: their biases.

    Returns:
        None below two runs, or where all finished within `SHORTEST_DRIFT`.
    """
    if len(finished_at) < 2 or max(finished_at) - min(finished_at) < SHORTEST_DRIFT:
        return None
    days = [(at - finished_at[0]).total_seconds() / SECONDS_PER_DAY for at in finished_at]
    mean_day, mean_bias = sum(days) / len(days), sum(bias_deg) / len(days)
    # Plain floats: a unit has a few runs, for which numpy's calls would cost ten times the sums
    power = sum((day - mean_day) ** 2 for day in days)
    pairs = list(zip(days, bias_deg, strict=True))
    return sum((day - mean_day) * (bias - mean_bias) for day, bias in pairs) / power


def components(unit: Sequence[int], value: Sequence[float | None]) -> Components:
    """One-way variance components of runs within units.

    Analysis of variance for unequal numbers of runs (Searle, Casella & McCulloch, Variance Components, 1992,
    section 3.6): within² = MSW, between² = (MSB − MSW)/n₀ with n₀ = (N − Σnᵢ²/N)/(k − 1), not below 0.
    `within` needs a unit with two runs; `between` needs that and two units.

    Args:
        unit: (N,) index of the unit of each run, from 0.
        value: (N,) the figure; None where it is not known.
    """
    values = np.array([np.nan if one is None else one for one in value], dtype=np.float64)
    known = np.isfinite(values)
    units, values = np.asarray(unit, dtype=np.intp)[known], values[known]
    runs = np.bincount(units)
    runs_of_unit = runs[runs > 0]
    k, n = len(runs_of_unit), len(values)
    if n == k:
        return Components(None, None)
    values = values - values.mean()  # sums of squares below lose no digits to a common level
    means = (np.bincount(units, values) / np.maximum(runs, 1))[units]
    within = float(((values - means) ** 2).sum()) / (n - k)
    if k < 2:
        return Components(None, math.sqrt(within))
    between = float((means**2).sum()) / (k - 1)
    runs_effective = (n - float((runs_of_unit**2).sum()) / n) / (k - 1)
    return Components(math.sqrt(max(between - within, 0.0) / runs_effective), math.sqrt(within))
