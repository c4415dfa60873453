"""Fit the joint model by Gauss-Newton, without outliers, with noise correlated from pose to pose.

A parameter's prior is how large it may be in any part that is sold (`widths`). It only bounds what the data
do not determine at all (Björck, Numerical Methods for Least Squares Problems, 1996, section 5.3).

The noise is a first-order autoregression within each mount of each run. At a correlation of 0.3 or 0.6, two
standard errors that ignore it cover 86 or 70 % instead of 95 %. The correlation is found by restricted
likelihood, because that of the residuals alone is too small if a model has many parameters (Patterson &
Thompson, Biometrika 58, 1971).
"""

from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.diagnosis.outliers import most_outliers
from calrig.calibration.separation.normal_equations import Inverse, Normal
from calrig.calibration.separation.pose_table import GROSS_G
from calrig.calibration.separation.problem import Problem
from calrig.estimation.angles import BoolArray, FloatArray, Intp

STEPS = 30
CONVERGED = 1e-4
"""Of a standard error, a step that changes nothing any more."""
HUBER = {2: 2.5, 3: 3.0}
"""Standard deviations of a pose, by how many components are solved for, beyond which it counts less, while it
is not known which have gone wrong.
"""
MEDIANS = np.array([np.nan, 0.4549, 1.3863, 2.366])
"""Of χ² with one, two and three degrees of freedom."""
LEAST_NOISE = 1e-6
"""Of poses without noise, as cells of six decimals have it, g."""
OUTLIER_STD = 7.0
"""Standard deviations from the model, beyond which noise takes no pose."""
ROUNDS = 4
IDENTIFIED = 0.33
"""Of how large a parameter may be: one whose standard error is more is not identified."""
SHAPES = 3
"""Rounds in which the components' noise is found."""
LEAST_SHAPE = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The joint model, fitted.

    Attributes:
        parameters: (p,) radians and g.
        inverse: the covariance over the noise's square; 0 of what is not free.
        noise: standard deviation of one component of a pose, root mean square over components and units, g,
            which is its angle's in rad.
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
        """Return (m, m) the covariance of what is linear (m, p) in the parameters."""
        return self.noise**2 * self.inverse.between(rows)

    def covariance_at(self, places: Intp) -> FloatArray:
        """Return (m, m) the covariance of some parameters."""
        return self.noise**2 * self.inverse.at(places)

    @property
    def kept(self) -> BoolArray:
        """(n,) the poses it rests on."""
        return np.asarray(self.weights > 0.0)

    @property
    def stds(self) -> FloatArray:
        """(p,) standard errors."""
        return np.asarray(self.noise * np.sqrt(np.maximum(self.inverse.diagonal(), 0.0)))

    def left(self) -> FloatArray:
        """(n,) angle about the stage's axis, measured less expected, rad."""
        table = self.problem.table
        found = table.turn() - table.turn_of(self.problem.expected(self.parameters).vector_g)
        return np.asarray(np.angle(np.exp(1j * found)))

    def leverage(self) -> FloatArray:
        """(n, c) share of each response that its own measurement has in what is expected of it."""
        problem = self.problem
        found = np.zeros_like(self.normal.residuals)
        of_map = np.arange(problem.first_order, problem.size)
        for k in range(len(problem.table.mounts)):
            rows = problem.table.mount == k
            inverse = self.inverse.at(np.concatenate([problem.own[k], of_map]))
            derivatives = self.normal.derivatives[rows]
            found[rows] = ((derivatives @ inverse) * derivatives).sum(axis=2)
        return found

    def identified(self) -> tuple[int, int]:
        """How many directions of the free parameters the poses identify, and of how many.

        A direction is identified where it is known better than to a third of how large it may be.
        """
        free = self.problem.free
        scale = self.problem.widths()[free] / self.noise
        size = np.linalg.eigvalsh(self.normal.matrix.whole()[np.ix_(free, free)] * np.outer(scale, scale))
        return int((size > 1.0 / IDENTIFIED**2).sum()), int(free.sum())


def fitted(
    problem: Problem, weights: FloatArray, start: FloatArray | None = None, *, robust: bool = False
) -> Fit:
    """The least squares solution, poses weighted by 1 or 0 (n,).

    It begins at `start` (p,), or at faultless units. With `robust`, poses far off count less, after Huber;
    the noise is then that of the most.
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
    return problem.inverse(normal.matrix.plus(noise**2 * problem.widths() ** -2.0))


def _freedom(problem: Problem, normal: Normal, weights: FloatArray, inverse: Inverse) -> float:
    """Responses less the parameters that they tell: the trace of the matrix that predicts them."""
    responses = float((problem.table.responses * weights).sum())
    return max(responses - inverse.times_trace(normal.matrix), 1.0)


def without_outliers(problem: Problem) -> tuple[Fit, FloatArray]:
    """The least squares solution without poses that have gone wrong alone, and the weights (n,) of all.

    They are found by fits in which poses far off count less, then left out. Where many are far off it is the
    model that is wrong, and none is left out.
    """
    gross = np.abs(problem.table.size_g - 1.0) > GROSS_G
    weights = np.where(gross, 0.0, 1.0)
    fit = fitted(problem, weights, robust=True)
    for _ in range(ROUNDS):
        outlying = gross | (distances(fit) > OUTLIER_STD)
        if outlying.sum() > most_outliers(len(outlying)):
            weights = np.where(gross, 0.0, 1.0)
            break
        if (outlying == (weights == 0.0)).all():
            break
        weights = np.where(outlying, 0.0, 1.0)
        fit = fitted(problem, weights, fit.parameters, robust=True)
    return fitted(problem, weights, fit.parameters), weights


def distances(fit: Fit) -> FloatArray:
    """(n,) how far each pose lies from what the others say of it, in standard deviations."""
    share = fit.leverage().max(axis=1)
    room = 1.0 - np.where(fit.kept, share, -share)
    far = np.linalg.norm(fit.normal.residuals, axis=1) / fit.noise
    return np.asarray(far / np.sqrt(np.clip(room, 0.05, None)))


def with_noise_of_components(fit: Fit) -> Fit:
    """The same fit with the noise of each unit's components estimated by themselves."""
    units = fit.problem.table.unit
    for _ in range(SHAPES):
        shape = fit.problem.shape
        shape = (
            np.ones((len(fit.problem.table.units), fit.normal.residuals.shape[1])) if shape is None else shape
        )
        share, squares, freedom = fit.leverage(), np.zeros_like(shape), np.zeros_like(shape)
        for unit in range(len(shape)):
            rows = fit.kept & (units == unit)
            squares[unit] = (fit.normal.residuals[rows] ** 2).sum(axis=0)
            freedom[unit] = rows.sum() - share[rows].sum(axis=0)
        noise_g = shape * np.sqrt(squares / np.maximum(freedom, 1.0))
        shape = np.maximum(noise_g / max(np.sqrt(np.mean(noise_g**2)), LEAST_NOISE), LEAST_SHAPE)
        shape /= np.sqrt(np.mean(shape**2))
        fit = fitted(replace(fit.problem, shape=shape), fit.weights, fit.parameters)
    return fit


def _huber(normal: Normal, noise: float) -> FloatArray:
    """(n,) 1 of poses near the model, less with distance."""
    far = np.linalg.norm(normal.residuals, axis=1) / noise
    near = HUBER[normal.residuals.shape[1]]
    return np.asarray(near / np.maximum(far, near))


def _noise(problem: Problem, normal: Normal, weights: FloatArray) -> float:
    """Standard deviation of a component, by the median over the poses: a few of them may be anything."""
    squares = (normal.residuals**2).sum(axis=1)
    scaled = squares / MEDIANS[problem.table.responses]
    return max(float(np.sqrt(np.median(scaled[weights > 0.0]))), LEAST_NOISE)


def _is_small(change: FloatArray, inverse: Inverse, noise: float) -> bool:
    errors = noise * np.sqrt(np.maximum(inverse.diagonal(), 0.0))
    moved = np.abs(change) > CONVERGED * errors
    return not bool(moved.any())


LARGEST_CORRELATION = 0.95
CLOSE = 5e-3
LEAST_SQUARES = 1e-300
"""Whose logarithm is still a number."""


def correlation_of(fit: Fit) -> float:
    """Lag-1 correlation of the noise of poses fitted as uncorrelated; none if nothing tells their order."""
    from scipy.optimize import minimize_scalar

    if not fit.problem.table.in_order:
        return 0.0
    found = minimize_scalar(
        lambda rho: _criterion(fit, float(rho)), bounds=(0.0, LARGEST_CORRELATION), options={"xatol": CLOSE}
    )
    return float(found.x)


def _criterion(fit: Fit, rho: float) -> float:
    """−2 log of the restricted likelihood, the noise profiled out; linear about the fit."""
    problem = replace(fit.problem, correlation=rho)
    normal = problem.normal(fit.parameters, fit.weights)
    inverse = _inverse(problem, normal, fit.noise)
    squares = max(normal.squares - float(normal.gradient @ inverse.solve(normal.gradient)), LEAST_SQUARES)
    return fit.freedom * float(np.log(squares)) + normal.log_variance + inverse.log_determinant
