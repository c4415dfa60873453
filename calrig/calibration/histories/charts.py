"""Chart a unit's or a rig's history, and forecast when the unit is due.

Control charts for short histories: the mean is learned from the runs, the spread is known. The due date is
the day on which the forecast of the drift, with its uncertainty, reaches a limit.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray


@dataclass(frozen=True, slots=True)
class Ewma:
    """An exponentially weighted moving average.

    Attributes:
        weight: of the latest point.
        limit: in standard deviations of the average.
        opens_narrow: whether the limits follow the average's own standard deviation, which begins small;
            else they are those of a long series from the first point on.
    """

    weight: float
    limit: float
    opens_narrow: bool

    def limits(self, n: int) -> FloatArray:
        """(n,) the limit for the first, second, … point of the average, for points of variance 1.

        L·√(λ/(2 − λ)·(1 − (1 − λ)^{2i})) (Lucas & Saccucci, Technometrics 32, 1990, equation 3);
        NIST/SEMATECH e-Handbook, 6.3.2.4, without the last factor.
        """
        share = self.weight / (2.0 - self.weight)
        decay = (1.0 - self.weight) ** (2.0 * np.arange(1, n + 1)) if self.opens_narrow else np.zeros(n)
        return np.asarray(self.limit * np.sqrt(share * (1.0 - decay)), dtype=np.float64)


UNIT_CHART = Ewma(weight=0.3, limit=2.82, opens_narrow=True)
"""Of a unit: few runs. Within any twelve at most 5 % false alarms (`python -m tests.studies.charts`)."""
RIG_CHART = Ewma(weight=0.2, limit=2.86, opens_narrow=True)
"""Of a rig by its check unit. One false alarm in 370 runs; a shift of 1σ is seen after 9, of 2σ after 2.9."""


PUT_RIGHT = 2.0
"""Standard deviations from the mean within which one check says that a rig that failed is right again."""


@dataclass(frozen=True, slots=True)
class ControlChart:
    """A chart of n runs, or of many series of n at once.

    Attributes:
        average: (…, n) the moving average of self-started scores (`q_statistics`, `normal_score`), which are
            independent and standard normal while nothing changes; 0 for the first run.
        limit: (n,) what it must not exceed; infinite for the first.
        signals: (…, n) whether it does.
    """

    average: FloatArray
    limit: FloatArray
    signals: npt.NDArray[np.bool_]


def normal_score(q: FloatArray | float, freedom: FloatArray | float | None) -> FloatArray:
    """Values of Student's t as the normal ones that are as likely: Φ⁻¹(T_ν(q)), q itself where ν is None.

    So a spread that few repeats tell makes no false alarms of its own (Quesenberry 1991, equation 7).
    """
    if freedom is None:
        return np.asarray(q, dtype=np.float64)
    from scipy.special import ndtri, stdtr

    tail = np.maximum(stdtr(freedom, -np.abs(q)), np.finfo(np.float64).tiny)
    return np.asarray(-np.sign(q) * ndtri(tail), dtype=np.float64)


def q_statistics(value: FloatArray, variance: FloatArray) -> FloatArray:
    """(…, n) self-started: each value less the weighted mean of those before it, over its standard deviation.

    Qᵢ = (xᵢ − x̄ᵢ₋₁)/√(vᵢ + 1/Σ_{j<i} 1/vⱼ): Quesenberry's Q for a mean that is not known and a standard
    deviation that is (Journal of Quality Technology 23, 1991, equation 3), for values of unequal variances.

    Args:
        value: (…, n) in the order measured.
        variance: (…, n) of each, known: its own u² and s² of re-clamping and the day.
    """
    weight = 1.0 / np.asarray(variance, dtype=np.float64)
    total = np.cumsum(weight, axis=-1)
    mean = np.cumsum(weight * value, axis=-1) / total
    q = np.zeros(np.shape(value))
    q[..., 1:] = (value[..., 1:] - mean[..., :-1]) / np.sqrt(variance[..., 1:] + 1.0 / total[..., :-1])
    return q


def moving_average(q: FloatArray, weight: float) -> FloatArray:
    """(…, n) zᵢ = λ·qᵢ + (1 − λ)·zᵢ₋₁, from z = 0."""
    average = np.zeros(np.shape(q))
    z = np.zeros(np.shape(q)[:-1])
    for i in range(np.shape(q)[-1]):
        z = weight * q[..., i] + (1.0 - weight) * z
        average[..., i] = z
    return average


def control_chart(
    value: FloatArray, variance: FloatArray, ewma: Ewma, freedom: FloatArray | None = None
) -> ControlChart:
    """Chart a history: self-started Q, then their moving average.

    Args:
        value: (…, n) in the order measured.
        variance: (…, n) of each, known.
        ewma: `UNIT_CHART` or `RIG_CHART`.
        freedom: (…, n) degrees of freedom that the variances rest on; None where they are known.
    """
    q = normal_score(q_statistics(value, variance), freedom)
    n = q.shape[-1]
    average = np.zeros(q.shape)
    average[..., 1:] = moving_average(q[..., 1:], ewma.weight)
    limit = np.concatenate([[np.inf], ewma.limits(max(n - 1, 0))])[:n]
    return ControlChart(average, limit, np.abs(average) > limit)


@dataclass(frozen=True, slots=True)
class Checks:
    """The results of n checks of a rig.

    Attributes:
        average: (n,) as in `ControlChart`; it restarts after each failure.
        limit: (n,) control limit of the average; infinite where the average was not tested.
        failed: (n,) whether the check failed.
        known: (n,) whether there was a mean to test it against: not for the first.
    """

    average: FloatArray
    limit: FloatArray
    failed: npt.NDArray[np.bool_]
    known: npt.NDArray[np.bool_]


def checks(
    value: FloatArray, variance: FloatArray, judged_from: int, freedom: FloatArray | None = None
) -> Checks:
    """Chart the checks of a rig (`RIG_CHART`) by its check standard: the mean is of the checks that passed.

    A failed check never moves the mean. A rig that failed passes again with the first check within
    `PUT_RIGHT` standard deviations of the mean, and the average restarts there. A shift before
    `judged_from` is no failure: the mean restarts with it.

    Args:
        value: (n,) of the check unit on the rig, in the order measured.
        variance: (n,) of each, known.
        judged_from: place of the first run that is a check; those before it are its history.
        freedom: (n,) degrees of freedom that the variances rest on; None where they are known.
    """
    n = len(value)
    average = np.zeros(n)
    failed, known = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    weight, mean, z, failing = 0.0, 0.0, 0.0, False
    limits, since, held = RIG_CHART.limits(n), 0, np.full(n, np.inf)
    for i in range(n):
        if weight > 0.0:
            known[i] = True
            t = (value[i] - mean) / np.sqrt(variance[i] + 1.0 / weight)
            q = float(normal_score(t, None if freedom is None else freedom[i]))
            z = RIG_CHART.weight * q + (1.0 - RIG_CHART.weight) * z
            average[i], held[i] = z, limits[since]
            out = abs(q) > PUT_RIGHT if failing else abs(z) > limits[since]
            since += 1
            failing = out and i >= judged_from
            failed[i] = failing
            if failing or out:
                z, since = 0.0, 0
            if failing:
                continue
            if out:
                weight = 0.0
        own = 1.0 / variance[i]
        mean = (weight * mean + own * value[i]) / (weight + own)
        weight += own
    return Checks(average, held, failed, known)


FEWEST_RUNS = 3
"""Two runs lie on a line whatever the unit does."""
COVERAGE = 1.6448536269514722
"""One-sided 95 % of a normal distribution: the chance to be in tolerance until then."""
LONGEST = 2.0
"""Intervals that a forecast may reach at most, or as long as the history is: it extrapolates no further."""
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
