"""Estimate by REML what re-clamping, the day and the rig add to a figure, pooled over all units.

The standard error of one run covers the noise of its poses alone. Runs between which a unit changed are
detected first and split the unit, so that they do not inflate the spread.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import BoolArray, FloatArray

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


FEWEST_REPEATS = 3
"""Least number of repeats: of two that disagree, either may be the change."""
FEWEST_ALIKE = 2
"""Repeats left without what changed; with one, nothing but a factor of 13 would be significant."""
MOST_RUNS = 700
"""Units calibrated last, up to as many runs, are pooled: they tell a spread to 3 % of itself."""
OUTLYING = 0.05
"""Chance that a run of good repeats loses one of them in the search for those that changed."""
HALF_OF_CHI2 = 0.4549
"""Median of χ² with one degree of freedom."""


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Standard deviations of one figure over what is done between two runs of a unit.

    Attributes:
        run: what re-clamping adds, and the day where it cannot be told apart.
        day: what the day of a rig adds; None where it is in `run`.
        rig: between rigs; 0 with one.
        unit: between units; 0 with one.
        freedom: degrees of freedom of `run`, and of the whole where days are told.
    """

    run: float
    day: float | None
    rig: float
    unit: float
    freedom: int

    @property
    def between_days(self) -> float:
        """Standard deviation of a run on another day, beyond its own standard error."""
        return float(np.hypot(self.run, self.day or 0.0))


@dataclass(frozen=True, slots=True)
class Runs:
    """N runs, by unit and within a unit in the order measured.

    Attributes:
        unit, rig, day: (N,) each, from 0; a day is one of one rig.
        value: (N,) the figure; NaN where not known.
        std: (N,) standard error of type A; NaN where not known, which counts as 0.
        stage_variance: (N,) what the stage is worth in the figure (type B); counts where the rig changed.
    """

    unit: IntArray
    rig: IntArray
    day: IntArray
    value: FloatArray
    std: FloatArray
    stage_variance: FloatArray

    def known(self) -> IntArray:
        """Runs that have the figure."""
        return np.flatnonzero(np.isfinite(self.value))


def pairs(unit: IntArray) -> tuple[IntArray, IntArray]:
    """Places of each run and the next of its unit, where units come one after the other."""
    first = np.flatnonzero(unit[1:] == unit[:-1]) if len(unit) else np.empty(0, dtype=np.intp)
    return first, first + 1


def outlying(difference: FloatArray, variance: FloatArray) -> BoolArray:
    """(K,) which of many differences are too large to be repeats of nothing but noise.

    Each has its own `variance` and all share one spread besides. Taken out one after the other, the most
    extreme first, up to nearly half of them; those count that precede the last which is significant beside
    all that remain (the generalised extreme Studentised deviate: Rosner, Technometrics 25, 1983). Their
    shared spread is the s² with Σd²/(v + s²) = n (Paule & Mandel, Journal of Research of the NBS 87, 1982).

    Args:
        difference: (K,) of repeats.
        variance: (K,) what is known of each.
    """
    from scipy.special import stdtrit

    size, n = np.abs(difference), len(difference)
    out = np.zeros(n, dtype=bool)
    if n < FEWEST_REPEATS:
        return out
    squares = size**2
    robust = max(float(np.median(squares)) / HALF_OF_CHI2 - float(np.median(variance)), 0.0)
    extreme = size / np.sqrt(np.maximum(variance + robust, 1e-300))
    order = np.argsort(-extreme, kind="stable")
    most = min((n - 1) // 2, max(int((extreme > 2.5).sum()), 3))  # beyond these nothing stands out
    squares, variance = squares[order], variance[order]
    for taken in range(most, 0, -1):
        rest = slice(taken, None)
        spread = _shared_spread(squares[rest], variance[rest])
        left = n - taken
        limit = float(stdtrit(left, 1.0 - OUTLYING / (2.0 * (left + 1))))
        if squares[taken - 1] > limit**2 * (variance[taken - 1] + spread):
            out[order[:taken]] = True
            return out
    return out


def _shared_spread(squares: FloatArray, variance: FloatArray) -> float:
    """The s² >= 0 with Σ squares/(variance + s²) = n, by Newton's method from below."""
    n, s2 = len(squares), 0.0
    floor = max(1e-12 * float(squares.max(initial=0.0)), 1e-100)  # runs that agree to the last digit
    for _ in range(50):
        weight = 1.0 / (variance + s2 + floor)
        excess = float(squares @ weight) - n
        if excess <= 1e-6 * n:
            break
        s2 += excess / float(squares @ weight**2)
    return s2


def repeatability(runs: Runs, changed: IntArray) -> Repeatability | None:
    """How a figure repeats, with what changed kept apart.

    Args:
        runs: by unit, in the order measured.
        changed: places of runs before which their unit changed: from there on it counts as another one.

    Returns:
        None where fewer than `FEWEST_REPEATS` repeats tell, or fewer than `FEWEST_ALIKE` without the changes.
    """
    begins = np.ones(len(runs.unit), dtype=bool)
    begins[1:] = runs.unit[1:] != runs.unit[:-1]
    begins[changed] = True
    kept = _pooled(runs)
    segment = np.unique(np.cumsum(begins)[kept], return_inverse=True)[1]
    repeats = len(kept) - (int(segment.max()) + 1 if len(kept) else 0)
    if len(kept) - len(np.unique(runs.unit[kept])) < FEWEST_REPEATS or repeats < FEWEST_ALIKE:
        return None
    rig = np.unique(runs.rig[kept], return_inverse=True)[1]
    day = np.unique(runs.day[kept], return_inverse=True)[1]
    layout = Layout(segment, rig, day, np.nan_to_num(runs.std[kept]) ** 2)
    found = variance_components(runs.value[kept], layout)
    freedom = repeats
    if found.day is not None:
        freedom = max(min(repeats - (layout.days - layout.rigs), layout.days - layout.rigs), 1)
    root = np.sqrt([found.run, found.day or 0.0, found.rig, found.unit])
    run, of_day, of_rig, of_unit = (float(one) for one in root)
    return Repeatability(run, None if found.day is None else of_day, of_rig, of_unit, freedom)


def _pooled(runs: Runs) -> IntArray:
    """Places of the runs that are pooled: whole units, those with the latest days first."""
    known = runs.known()
    if len(known) <= MOST_RUNS:
        return known
    counts = np.bincount(runs.unit[known])
    latest = np.full(len(counts), -1)
    np.maximum.at(latest, runs.unit[known], runs.day[known])
    order = np.argsort(-latest, kind="stable")
    taken = order[np.cumsum(counts[order]) <= MOST_RUNS]
    return known[np.isin(runs.unit[known], taken)]
