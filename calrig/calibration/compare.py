"""Units side by side: how a unit drifts, and how units differ beyond what one repeats."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

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
