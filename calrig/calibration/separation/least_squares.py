"""Gauss and Newton's iteration on the joint model.

What is not known of a parameter before the data is how large it may be in any part that is sold (`widths`).
Where the data say anything at all that is nothing beside it: it only keeps what they do not say at all from
running off (Björck, Numerical Methods for Least Squares Problems, 1996, section 5.3).

Noise that is correlated from pose to pose: a first-order autoregression within each mount of each run.

At a correlation of 0.3 or 0.6 the mean of poses that follow one another is worth half or a quarter of as many
that do not, and two standard errors that deny it hold in 86 or 70 % of cases in place of 95. The correlation
is found by restricted likelihood: that of residuals alone is too small where a model has many parameters
(Patterson & Thompson, Biometrika 58, 1971).

A gear whose period nobody stated: what the poses leave, against every period that their angles resolve.

A worm's error repeats many times in a turn, beyond the orders that a map has by itself; noise takes it up,
which is honest and tells nobody. The best of all periods is told of if noise would make the best of them as
good in one case of a hundred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.separation.mounts import fitted_without_outliers
from calrig.calibration.separation.pose_table import BoolArray, Intp, Inverse, whitened
from calrig.calibration.separation.problem import OWN, Normal, Problem
from calrig.calibration.separation.stage_map import HIGHEST_ORDER, TURN_DEG, told_order, widest_gap_deg
from calrig.estimation.angles import FloatArray

STEPS = 30
CONVERGED = 1e-4
"""Of a standard error, a step that changes nothing any more."""
HUBER = 2.5
"""Standard deviations beyond which a pose counts less, while it is not known which have gone wrong."""
MEDIAN_OF_TWO, MEDIAN_OF_ONE = 1.3863, 0.4549
"""Medians of χ² with two degrees of freedom and with one."""
LEAST_NOISE = 1e-6
"""Of poses without noise, as cells of six decimals have it, g."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The joint model, fitted.

    Attributes:
        parameters: (p,) radians and g.
        inverse: the covariance over the noise's square; 0 of what is not free.
        noise: standard deviation of one component of a pose, g, which is its angle's in rad.
        freedom: its degrees of freedom.
        normal: about the parameters, unweighted poses left out.
        weights: (n,) 0 of poses left out.
    """

    problem: Problem
    parameters: FloatArray
    inverse: Inverse
    noise: float
    freedom: float
    normal: Normal
    weights: FloatArray

    def covariance_of(self, rows: FloatArray) -> FloatArray:
        """(m, m) of what is linear (m, p) in the parameters."""
        return self.noise**2 * self.inverse.between(rows)

    def covariance_at(self, places: Intp) -> FloatArray:
        """(m, m) of some parameters."""
        return self.covariance_of(np.eye(len(self.parameters))[places])

    @property
    def kept(self) -> BoolArray:
        """(n,) the poses it rests on."""
        return np.asarray(self.weights > 0.0)

    def left(self) -> FloatArray:
        """(n,) angle measured less angle expected, rad."""
        found = self.problem.table.angle() - self.problem.expected(self.parameters).angle()
        return np.asarray(np.angle(np.exp(1j * found)))


def fitted(
    problem: Problem, weights: FloatArray, start: FloatArray | None = None, *, robust: bool = False
) -> Fit:
    """The least squares solution.

    Args:
        problem: the model.
        weights: (n,) 1 or 0.
        start: (p,) where to begin; from faultless units without it.
        robust: poses far off count less, after Huber; the noise is then that of the most.
    """
    free, prior = problem.free, problem.widths() ** -2.0
    centre = problem.start()
    parameters = np.where(free, centre if start is None else start, 0.0)
    centre = np.where(free, centre, 0.0)
    noise, own = np.inf, weights
    for step in range(STEPS):
        normal = problem.normal(parameters, own)
        noise = _noise(problem, normal, weights)
        if robust and step > 1:
            own = weights * _huber(normal, noise)
            normal = problem.normal(parameters, own)
        inverse = _inverse(problem, normal, noise)
        change = inverse.solve(normal.gradient - noise**2 * prior * (parameters - centre))
        parameters = parameters + change
        if np.abs(change).max(initial=0.0) == 0.0 or _is_small(change, inverse, noise):
            break
    normal = problem.normal(parameters, own)
    freedom = _freedom(problem, normal, weights, _inverse(problem, normal, noise))
    noise = noise if robust else max(float(np.sqrt(normal.squares / freedom)), LEAST_NOISE)
    inverse = _inverse(problem, normal, noise)
    return Fit(problem, parameters, inverse, noise, freedom, normal, weights)


def at_parameters(problem: Problem, parameters: FloatArray, noise: float) -> Fit:
    """What a fit of such poses would find, were these the parameters and this the noise."""
    weights = np.ones(len(problem.table))
    normal = problem.normal(parameters, weights)
    inverse = _inverse(problem, normal, noise)
    freedom = _freedom(problem, normal, weights, inverse)
    return Fit(problem, parameters, inverse, noise, freedom, normal, weights)


def _inverse(problem: Problem, normal: Normal, noise: float) -> Inverse:
    """The covariance over the noise's, by the data and what is known before them."""
    matrix = normal.matrix.copy()
    matrix[np.diag_indices_from(matrix)] += noise**2 * problem.widths() ** -2.0
    return problem.inverse(matrix)


def _freedom(problem: Problem, normal: Normal, weights: FloatArray, inverse: Inverse) -> float:
    """Responses less the parameters that they tell: the trace of the matrix that predicts them."""
    responses = float(((1 + problem.table.has_vector) * weights).sum())
    return max(responses - inverse.times_trace(normal.matrix), 1.0)


def without_outliers(problem: Problem) -> tuple[Fit, FloatArray]:
    """The least squares solution without poses that have gone wrong alone, and the weights (n,) of all."""
    size_g = np.hypot(problem.table.vector_g[:, 0], problem.table.vector_g[:, 1])
    return fitted_without_outliers(
        lambda weights, start, robust: fitted(problem, weights, start, robust=robust), distances, size_g
    )


def distances(fit: Fit) -> FloatArray:
    """(n,) how far each pose lies from what the others say of it, in standard deviations."""
    problem, inverse = fit.problem, fit.inverse.whole()
    far = np.linalg.norm(fit.normal.residuals, axis=1) / fit.noise
    of_map = np.arange(problem.first_order, problem.size)
    for k in range(len(problem.table.mounts)):
        rows = np.flatnonzero(problem.table.mount == k)
        at = np.concatenate([problem.own_at(k), of_map])
        derivatives = fit.normal.derivatives[rows]
        share = ((derivatives @ inverse[np.ix_(at, at)]) * derivatives).sum(axis=2).max(axis=1)
        room = 1.0 - np.where(fit.kept[rows], share, -share)
        far[rows] /= np.sqrt(np.clip(room, 0.05, None))
    return np.asarray(far)


def _huber(normal: Normal, noise: float) -> FloatArray:
    """(n,) 1 of poses near the model, less with distance."""
    far = np.linalg.norm(normal.residuals, axis=1) / noise
    return np.asarray(HUBER / np.maximum(far, HUBER))


def _noise(problem: Problem, normal: Normal, weights: FloatArray) -> float:
    """Standard deviation of a component, by the median over the poses: a few of them may be anything."""
    squares = (normal.residuals**2).sum(axis=1)
    scaled = squares / np.where(problem.table.has_vector, MEDIAN_OF_TWO, MEDIAN_OF_ONE)
    return max(float(np.sqrt(np.median(scaled[weights > 0.0]))), LEAST_NOISE)


def _is_small(change: FloatArray, inverse: Inverse, noise: float) -> bool:
    errors = noise * np.sqrt(np.maximum(inverse.diagonal(), 0.0))
    moved = np.abs(change) > CONVERGED * errors
    return not bool(moved.any())


LARGEST = 0.95
CLOSE = 5e-3
LEAST_SQUARES = 1e-300
"""Whose logarithm is still a number."""


def correlation_of(fit: Fit) -> float:
    """Lag-1 correlation of the poses' noise, none where nothing tells in which order they were measured.

    Args:
        fit: of all parameters, to poses taken as uncorrelated.
    """
    from scipy.optimize import minimize_scalar

    if not fit.problem.table.in_order:
        return 0.0
    found = minimize_scalar(
        lambda rho: _criterion(fit, float(rho)), bounds=(0.0, LARGEST), options={"xatol": CLOSE}
    )
    return float(found.x)


def _criterion(fit: Fit, rho: float) -> float:
    """−2 log of the restricted likelihood, the noise profiled out; linear about the fit."""
    problem = replace(fit.problem, correlation=rho)
    normal = problem.normal(fit.parameters, fit.weights)
    inverse = problem.inverse(normal.matrix + np.diag(fit.noise**2 * problem.widths() ** -2.0))
    squares = max(normal.squares - float(normal.gradient @ inverse.solve(normal.gradient)), LEAST_SQUARES)
    return fit.freedom * float(np.log(squares)) + normal.log_variance + inverse.log_determinant


LEVEL = 0.01
STEPS_A_WAVE = 2.0
"""Orders tried for each that an arc resolves."""


@dataclass(frozen=True, slots=True)
class Gear:
    """A period on the dial and its amplitude, degrees; `p_value` is of the best among all that were tried."""

    period_deg: float
    amplitude_deg: float
    p_value: float


def unstated_gear(fit: Fit) -> Gear | None:
    """What repeats on the dial beyond the map; None where nothing does, or the angles are too sparse."""
    from scipy.special import fdtrc

    table, rows = fit.problem.table, np.flatnonzero(fit.kept)
    dial_deg = table.dial_deg[rows]
    step = TURN_DEG / (TURN_DEG - widest_gap_deg(dial_deg)) / STEPS_A_WAVE
    orders = np.arange(HIGHEST_ORDER + 1.0, told_order(table.dial_deg), step)
    if not len(orders):
        return None
    by_angle = fit.normal.derivatives[rows][:, :, OWN - 1]
    chain = table.mount[rows] * len(table.sources) + table.source[rows]

    def white(values: np.ndarray) -> np.ndarray:
        return whitened(values, rows, chain, fit.problem.correlation)[0].reshape(2 * len(rows), -1)

    left = white(fit.normal.residuals[rows][:, :, None])[:, 0]
    gains, sizes = np.zeros(len(orders)), np.zeros(len(orders))
    for k, order in enumerate(orders):
        turn = np.radians(order * dial_deg)
        wave = white(by_angle[:, :, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)[:, None, :])
        across = wave.T @ left
        found = np.linalg.lstsq(wave.T @ wave, across, rcond=1e-6)[0]
        gains[k], sizes[k] = across @ found, np.hypot(*found)
    best = int(np.argmax(gains))
    freedom = fit.freedom - 2.0
    ratio = 0.5 * gains[best] / max(fit.freedom * fit.noise**2 - gains[best], 1e-300) * freedom
    p_value = min(len(orders) * float(fdtrc(2.0, freedom, ratio)), 1.0)
    if p_value > LEVEL:
        return None
    return Gear(TURN_DEG / float(orders[best]), math.degrees(sizes[best]), p_value)
