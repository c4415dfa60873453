"""Gauss and Newton's iteration on the joint model, and the poses that have gone wrong alone.

What is not known of a parameter before the data is how large it may be in any part that is sold (`widths`).
Where the data say anything at all that is nothing beside it: it only keeps what they do not say at all from
running off (Björck, Numerical Methods for Least Squares Problems, 1996, section 5.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.problem import Normal, Problem
from calrig.calibration.joint.table import BoolArray
from calrig.calibration.joint.unit_model import felt
from calrig.calibration.outliers import most_outliers
from calrig.estimation.angles import FloatArray

STEPS = 30
CONVERGED = 1e-4
"""Of a standard error, a step that changes nothing any more."""
HUBER = 2.5
"""Standard deviations beyond which a pose counts less, while it is not known which have gone wrong."""
WILD = 7.0
"""Standard deviations from the model, beyond which noise takes no pose."""
ROUNDS = 4
MEDIAN_OF_TWO, MEDIAN_OF_ONE = 1.3863, 0.4549
"""Medians of χ² with two degrees of freedom and with one."""
LEAST_NOISE = 1e-6
"""Of poses without noise, as cells of six decimals have it, g."""
GROSS_G = 0.5
"""A vector whose length is off by more is none of gravity."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The joint model, fitted.

    Attributes:
        parameters: (p,) radians and g.
        covariance: (p, p); 0 of what is not free.
        noise: standard deviation of one component of a pose, g, which is its angle's in rad.
        freedom: its degrees of freedom.
        normal: about the parameters, unweighted poses left out.
        weights: (n,) 0 of poses left out.
    """

    problem: Problem
    parameters: FloatArray
    covariance: FloatArray
    noise: float
    freedom: float
    normal: Normal
    weights: FloatArray

    @property
    def kept(self) -> BoolArray:
        """(n,) the poses it rests on."""
        return np.asarray(self.weights > 0.0)

    def left(self) -> FloatArray:
        """(n,) angle measured less angle expected, rad."""
        table, found = self.problem.table, np.zeros(len(self.weights))
        elevation = self.problem.elevations(self.parameters)
        for unit in range(len(table.units)):
            rows = np.flatnonzero(table.unit == unit)
            own = self.parameters[self.problem.unit_at(unit)]
            found[rows] = table.angle()[rows] - felt(own, elevation[rows], table.warmer_c[rows]).angle()
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
    free, prior = problem.free(), problem.widths() ** -2.0
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
        matrix = normal.matrix + np.diag(noise**2 * prior)
        ahead = normal.gradient - noise**2 * prior * (parameters - centre)
        inverse = _inverse(matrix, free)
        change = inverse @ ahead
        parameters = parameters + change
        if np.abs(change).max(initial=0.0) == 0.0 or _is_small(change, inverse, noise):
            break
    normal = problem.normal(parameters, own)
    freedom = _freedom(problem, normal, weights, noise)
    noise = noise if robust else max(float(np.sqrt(normal.squares / freedom)), LEAST_NOISE)
    return Fit(problem, parameters, _covariance(problem, normal, noise), noise, freedom, normal, weights)


def at_parameters(problem: Problem, parameters: FloatArray, noise: float) -> Fit:
    """What a fit of such poses would find, were these the parameters and this the noise."""
    weights = np.ones(len(problem.table))
    normal = problem.normal(parameters, weights)
    freedom = _freedom(problem, normal, weights, noise)
    return Fit(problem, parameters, _covariance(problem, normal, noise), noise, freedom, normal, weights)


def _covariance(problem: Problem, normal: Normal, noise: float) -> FloatArray:
    """(p, p) by the data and what is known before them."""
    known = np.diag(noise**2 * problem.widths() ** -2.0)
    return noise**2 * _inverse(normal.matrix + known, problem.free())


def _freedom(problem: Problem, normal: Normal, weights: FloatArray, noise: float) -> float:
    """Responses less the parameters that they tell: the trace of the matrix that predicts them."""
    responses = float(((1 + problem.table.has_vector) * weights).sum())
    told = _covariance(problem, normal, noise) / noise**2 * normal.matrix
    return max(responses - float(told.sum()), 1.0)


def without_wild_poses(problem: Problem) -> tuple[Fit, FloatArray]:
    """A robust fit, and the weights (n,) of the poses: 0 of those that have gone wrong alone.

    Where many are far off it is the model that is wrong, and none is left out.
    """
    size = np.hypot(problem.table.vector_g[:, 0], problem.table.vector_g[:, 1])
    gross = np.abs(size - 1.0) > GROSS_G
    weights = np.where(gross, 0.0, 1.0)
    fit = fitted(problem, weights, robust=True)
    for _ in range(ROUNDS):
        wild = gross | (distances(fit) > WILD)
        if wild.sum() > most_outliers(len(wild)):
            weights = np.where(gross, 0.0, 1.0)
            break
        if (wild == (weights == 0.0)).all():
            break
        weights = np.where(wild, 0.0, 1.0)
        fit = fitted(problem, weights, fit.parameters, robust=True)
    return fitted(problem, weights, fit.parameters), weights


def distances(fit: Fit) -> FloatArray:
    """(n,) how far each pose lies from what the others say of it, in standard deviations."""
    inverse = fit.covariance / fit.noise**2
    far = np.linalg.norm(fit.normal.residuals, axis=1) / fit.noise
    for rows, at, derivatives in fit.normal.blocks:
        share = np.einsum("nri,ij,nrj->nr", derivatives, inverse[np.ix_(at, at)], derivatives).max(axis=1)
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


def _is_small(change: FloatArray, inverse: FloatArray, noise: float) -> bool:
    errors = noise * np.sqrt(np.maximum(np.diag(inverse), 0.0))
    moved = np.abs(change) > CONVERGED * errors
    return not bool(moved.any())


def _inverse(matrix: FloatArray, free: BoolArray) -> FloatArray:
    """(p, p) of the free parameters' part, 0 elsewhere; scaled, so that units of measure do not matter."""
    scale = 1.0 / np.sqrt(np.diag(matrix)[free])
    part = matrix[np.ix_(free, free)] * np.outer(scale, scale)
    whole = np.zeros_like(matrix)
    whole[np.ix_(free, free)] = np.linalg.inv(part) * np.outer(scale, scale)
    return whole
