"""Which kinds of noise an Allan curve asks for, how much of each, and whether the log has a ramp.

Noise leaves a curve and, at its end, a slope in the log; it has to explain the curve without that slope, and
the slope too unless a ramp does. The variances at octaves of τ are compared on cube roots, which makes a
chi-square variable all but Gaussian even at the few degrees of freedom of a long τ (Wilson & Hilferty, PNAS
17, 1931), with the covariance that theory gives them. Every combination of kinds is tried, with a ramp and
without; each term must be worth its price.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calrig.estimation.angles import FloatArray
from calrig.noise.allan_theory import KINDS, CurveTheory

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
        slope_per_s: the log's slope.
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
    """Fits every combination of terms; None where none does."""
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
    """Fits log c; None where a kind vanishes, since the combination without it is another."""
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
