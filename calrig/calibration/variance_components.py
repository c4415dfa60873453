"""How much re-clamping, the day and the rig add to a figure: variance components by REML."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray

IntArray = npt.NDArray[np.intp]

FEWEST_DAYS = 6
"""Days, and runs beyond each unit's and each day's first: fewer say too little of a day's spread by itself,
which then stays within that of the runs."""
LEAST_VARIANCE, MOST_VARIANCE = 1e-10, 1e2
"""In variances of all values; the least counts as 0."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Which unit, rig and day each of N runs belongs to, counted from 0; a day is one of one rig.

    Attributes:
        unit, rig, day: (N,) each.
        known_variance: (N,) of each run, known beforehand (type A).
    """

    unit: IntArray
    rig: IntArray
    day: IntArray
    known_variance: FloatArray

    @property
    def days(self) -> int:
        """How many days of rigs there are."""
        return int(self.day.max()) + 1

    @property
    def rigs(self) -> int:
        """How many rigs there are."""
        return int(self.rig.max()) + 1

    @property
    def units(self) -> int:
        """How many units there are."""
        return int(self.unit.max()) + 1

    @property
    def tells_days(self) -> bool:
        """Whether a day's spread can be told from that of the runs, the units and the rigs."""
        spread_over_days = len(np.unique(self.unit * self.days + self.day)) > self.units
        repeats = len(self.day) - self.units - (self.days - self.rigs)
        return self.days - self.rigs + 1 >= FEWEST_DAYS and repeats >= FEWEST_DAYS and spread_over_days


@dataclass(frozen=True, slots=True)
class VarianceComponents:
    """Variances between units, rigs, days of a rig and runs (beyond what was known of each run).

    `day` is None where the layout does not tell it from `run`, which then holds both; `criterion` is
    −2 log restricted likelihood, without its constant.
    """

    unit: float
    rig: float
    day: float | None
    run: float
    criterion: float


def variance_components(value: FloatArray, layout: Layout) -> VarianceComponents:
    """Restricted maximum likelihood of crossed random effects: value = mean + unit + rig + day + run.

    With Z the indicators of units and rigs, G = diag of their variances and V₀ the covariance of days and
    runs, which is inverted a day at a time (Sherman & Morrison), V = V₀ + ZGZ′ needs one Cholesky
    factorisation of H = I + G^½ Z′V₀⁻¹Z G^½, of size units + rigs:

        −2 log L = log|V₀| + log|H| + log(1′V⁻¹1) + r′V⁻¹r

    (Patterson & Thompson, Biometrika 58, 1971; Searle, Casella & McCulloch, Variance Components, 1992,
    section 6.6.) Minimised over the logarithms of the variances by L-BFGS-B.

    Args:
        value: (N,) the figure of each run, N >= 2.
        layout: (N,) units, rigs, days and known variances.
    """
    level, size = float(value.mean()), float(value.std())
    from scipy.optimize import minimize  # a tenth of a second that a service need not start with

    if size == 0.0:
        return VarianceComponents(0.0, 0.0, 0.0 if layout.tells_days else None, 0.0, -math.inf)
    likelihood = _Likelihood((value - level) / size, layout, size)
    free = np.array([layout.units > 1, layout.rigs > 1, layout.tells_days, True])
    within = _within(likelihood.value, layout.unit)
    start = np.array([max(1.0 - within, 0.1), 0.1 * within, 0.5 * within, within])[free]

    def criterion(logs: FloatArray) -> float:
        variances = np.zeros(4)
        variances[free] = np.exp(logs)
        return likelihood(variances)

    shift = 2.0 * (len(value) - 1) * math.log(size)
    bounds = [(math.log(LEAST_VARIANCE), math.log(MOST_VARIANCE))] * len(start)
    found = minimize(criterion, np.log(start), method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-8})
    shares = np.exp(found.x)
    variances = np.zeros(4)
    variances[free] = np.where(shares > 10.0 * LEAST_VARIANCE, shares, 0.0) * size**2
    unit, rig, day, run = (float(one) for one in variances)
    return VarianceComponents(unit, rig, day if layout.tells_days else None, run, float(found.fun) + shift)


def _within(value: FloatArray, unit: IntArray) -> float:
    """Variance of runs about the mean of their unit: where the search begins."""
    runs = np.bincount(unit)
    means = (np.bincount(unit, value) / np.maximum(runs, 1))[unit]
    freedom = max(len(value) - int((runs > 0).sum()), 1)
    return max(float(((value - means) ** 2).sum()) / freedom, 1e-4)


class _Likelihood:
    """−2 log restricted likelihood of standardised values, by the four variances."""

    def __init__(self, value: FloatArray, layout: Layout, size: float) -> None:
        self.value, self._layout = value, layout
        self._known = layout.known_variance / size**2
        self._units = layout.units
        cells, self._cell = np.unique(layout.day * self._units + layout.unit, return_inverse=True)
        self._cell_day, self._cell_unit = np.divmod(cells, self._units)
        self._left, self._right = _same(self._cell_day)
        self._beside = np.zeros((len(value), layout.rigs + 2))
        self._beside[np.arange(len(value)), layout.rig] = 1.0
        self._beside[:, -2], self._beside[:, -1] = 1.0, value

    def __call__(self, variances: FloatArray) -> float:
        from scipy.linalg import cholesky, solve_triangular

        unit, rig, day, run = variances
        of_run = run + self._known + LEAST_VARIANCE
        x, log_det = self._products(1.0 / of_run, day)
        log_det += float(np.log(of_run).sum())
        n = len(x) - 2
        root = np.sqrt(np.repeat([unit, rig], [self._units, n - self._units]))
        h = x[:n, :n] * root * root[:, None]
        h.flat[:: n + 1] += 1.0
        lower = cholesky(h, lower=True, check_finite=False, overwrite_a=True)
        log_det += 2.0 * float(np.log(np.diag(lower)).sum())
        half = solve_triangular(lower, root[:, None] * x[:n, n:], lower=True, check_finite=False)
        left = x[n:, n:] - half.T @ half
        of_mean = float(left[0, 0])
        return log_det + math.log(of_mean) + float(left[1, 1] - left[0, 1] ** 2 / of_mean)

    def _products(self, weight: FloatArray, day: float) -> tuple[FloatArray, float]:
        """X′V₀⁻¹X of X = [units, rigs, 1, value], and log|V₀| less that of the runs."""
        layout, units = self._layout, self._units
        weighted = self._beside * weight[:, None]
        n = units + weighted.shape[1]
        x = np.zeros((n, n))
        x.flat[: units * n : n + 1] = np.bincount(layout.unit, weight)
        x[:units, units:] = _sums(layout.unit, weighted, units)
        x[units:, units:] = weighted.T @ self._beside
        log_det = 0.0
        if day > 0.0:  # V₀⁻¹ = W − W·Z·diag(shrunk)·Z′·W, Z the indicators of days
            by_day = np.bincount(layout.day, weight)
            shrunk = day / (1.0 + day * by_day)
            log_det = float(np.log1p(day * by_day).sum())
            of_days = _sums(layout.day, weighted, len(by_day)) * np.sqrt(shrunk)[:, None]
            of_cells = np.bincount(self._cell, weight) * np.sqrt(shrunk)[self._cell_day]
            both = self._cell_unit[self._left] * units + self._cell_unit[self._right]
            shared = np.bincount(both, of_cells[self._left] * of_cells[self._right], units * units)
            x[:units, :units] -= shared.reshape(units, units)
            x[:units, units:] -= _sums(self._cell_unit, of_cells[:, None] * of_days[self._cell_day], units)
            x[units:, units:] -= of_days.T @ of_days
        x[units:, :units] = x[:units, units:].T
        return x, log_det


def _sums(group: IntArray, columns: FloatArray, groups: int) -> FloatArray:
    """(groups, p) sums of (N, p) columns over each group."""
    return np.column_stack([np.bincount(group, column, groups) for column in columns.T])


def _same(group: IntArray) -> tuple[IntArray, IntArray]:
    """Every ordered pair of places in one group, of places that are sorted by it."""
    counts = np.bincount(group)
    begins = np.cumsum(counts) - counts
    partners = counts[group]
    left = np.repeat(np.arange(len(group)), partners)
    within = np.arange(len(left)) - np.repeat(np.cumsum(partners) - partners, partners)
    return left, begins[group[left]] + within
