"""Gauss and Newton's iteration on the joint model.

What is not known of a parameter before the data is how large it may be in any part that is sold (`widths`).
Where the data say anything at all that is nothing beside it: it only keeps what they do not say at all from
running off (Björck, Numerical Methods for Least Squares Problems, 1996, section 5.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.arrow import Inverse
from calrig.calibration.joint.outliers import fitted_without_outliers
from calrig.calibration.joint.problem import Normal, Problem
from calrig.calibration.joint.table import BoolArray, Intp
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
