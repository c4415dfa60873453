"""When a unit is due again: where the forecast of its drift, with its uncertainty, reaches a limit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calrig.estimation.angles import FloatArray

FEWEST_RUNS = 3
"""Two runs lie on a line whatever the unit does."""
COVERAGE = 1.6448536269514722
"""One-sided 95 % of a normal distribution: the chance to be in tolerance until then."""
LONGEST = 2.0
"""Intervals that a forecast may stretch the time to, or as long as the history is: nobody has seen beyond."""
CONFIDENCE = 0.99
SIGNIFICANT = 2.5758293035489004
"""Standard errors from where a drift is one (99 %, two-sided)."""


Bounds = tuple[float, float]
"""Lowest and highest value allowed; may be infinite."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """A straight line through a history, and until when it stays within its limits.

    Attributes:
        due_day: days since the first run, of the last one or later; None where the forecast does not tell.
        why: in words.
        fits: whether the history lies on a line as well as its variances say (χ², 99 %).
    """

    due_day: float | None
    why: str
    fits: bool


def forecast(
    day: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    limits: Bounds,
    interval_days: float,
) -> Forecast | None:
    """Variables method: when the drift of a figure, forecast from its history, may reach a limit.

    Weighted least squares with known variances, value(t) = a + b·t, whose forecast has the variance
    σ²(t) = σ_a² + 2·t·σ_ab + t²·σ_b²; where the history scatters about the line by more than its variances
    say, all are raised by χ²/(n − 2) (Birge). The unit is due at the first t at which a + b·t ± 1.645·σ(t)
    leaves the limits: until then it is within them with 95 % (NCSLI RP-1:2010, Establishment and Adjustment
    of Calibration Intervals, variables method; Castrup, Calibration Intervals from Variables Data, 2005).

    It says something where after one interval its uncertainty alone would not fill the limits, or where a
    drift beyond doubt reaches one sooner; it never reaches beyond `LONGEST` intervals or twice the history.

    Args:
        day: (n,) when each run was, days.
        value: (n,) the figure.
        variance: (n,) of each, known, more than 0: u² of the run and s² of re-clamping and the day.
        limits: what the figure must stay within.
        interval_days: the interval that counts before the forecast says something.

    Returns:
        None below `FEWEST_RUNS` runs at as many times.
    """
    if len(np.unique(day)) < FEWEST_RUNS:
        return None
    from scipy.special import chdtri

    weight = 1.0 / variance
    centre = float(weight @ day / weight.sum())
    t = day - centre
    level_var, slope_var = 1.0 / float(weight.sum()), 1.0 / float(weight @ t**2)
    level, slope = float(weight @ value) * level_var, float(weight @ (t * value)) * slope_var
    chi2 = float(weight @ (value - level - slope * t) ** 2)
    birge = max(chi2 / (len(day) - 2), 1.0)
    fits = chi2 <= float(chdtri(len(day) - 2, 1.0 - CONFIDENCE))
    level_var, slope_var = level_var * birge, slope_var * birge
    last = float(t.max())
    history = last - float(t.min())
    std = math.sqrt(slope_var)
    room = (limits[1] - limits[0]) / 2.0
    tells = COVERAGE * math.sqrt(level_var + (last + interval_days) ** 2 * slope_var) < room
    due = min(_leaves(level - limits[0], slope, level_var, slope_var, last),
              _leaves(limits[1] - level, -slope, level_var, slope_var, last))  # fmt: skip
    sooner = abs(slope) > SIGNIFICANT * std and due < last + interval_days
    if not (tells or sooner):
        return Forecast(None, "its history does not tell yet how it drifts", fits)
    longest = last + max(LONGEST * interval_days, history)
    if due > longest:
        return Forecast(longest + centre, "no limit is reached as far as can be foreseen", fits)
    return Forecast(due + centre, "its drift may have reached a limit by then", fits)


def _leaves(room: float, slope: float, level_var: float, slope_var: float, last: float) -> float:
    """The first t ≥ last with room + slope·t ≤ k·√(level_var + t²·slope_var); infinite if none."""
    if room + slope * last <= COVERAGE * math.sqrt(level_var + last**2 * slope_var):
        return last
    if math.isinf(room):
        return math.inf
    k2 = COVERAGE**2
    a, b, c = slope**2 - k2 * slope_var, slope * room, room**2 - k2 * level_var  # a·t² + 2·b·t + c = 0
    if a == 0.0:
        roots = [-c / (2.0 * b)] if b != 0.0 else []
    else:
        inner = b**2 - a * c
        roots = [] if inner < 0.0 else [(-b + sign * math.sqrt(inner)) / a for sign in (-1.0, 1.0)]
    later = [root for root in roots if root > last and room + slope * root >= -1e-9 * abs(room)]
    return min(later, default=math.inf)
