"""Gauss and Newton's iteration for whole accelerometers, the noise of each axis, and outliers.

As in the plane (`least_squares`), what is not known of a parameter before the data is how large it may be in
any part that is sold.

Stage, mounts and whole units from a set of poses, with how many orders the map has chosen by the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.poses import DiagnosisError
from calrig.calibration.progress import Progress, unheard
from calrig.calibration.separation.least_squares import CONVERGED, LEAST_NOISE, STEPS
from calrig.calibration.separation.mounts import fitted_without_outliers, outliers_said
from calrig.calibration.separation.order_choice import Choice, always, chosen, offered
from calrig.calibration.separation.pose_table import BoolArray, Intp, MountedPoses, Table
from calrig.calibration.separation.stage_map import TURN_DEG
from calrig.calibration.separation.three_axis_problem import Normal, ThreeAxisProblem
from calrig.calibration.separation.three_axis_table import ThreeAxisTable, face_matrix, three_axis_table
from calrig.estimation.angles import FloatArray

HUBER = 3.0
"""Standard deviations of the vector beyond which a pose counts less; one in 35 is of three components."""
MEDIAN_OF_THREE = 2.366
"""Median of χ² with three degrees of freedom."""
SHAPES = 3
"""Rounds in which the axes' noise is found."""
LEAST_SHAPE = 0.2
LARGEST_CORRELATION, CLOSE = 0.95, 5e-3
LEAST_SQUARES = 1e-300
UNTOLD = 0.33
"""Of how large a parameter may be: one whose standard error is more the data do not tell."""


@dataclass(frozen=True, slots=True, eq=False)
class ThreeAxisFit:
    """The model of whole units, fitted.

    Attributes:
        parameters: (p,) radians and g.
        covariance: (p, p); 0 of what is not free.
        noise: standard deviation of a component, root mean square over axes and units, g.
        freedom: its degrees of freedom.
        normal: about the parameters, poses of weight 0 left out.
        weights: (n,) 0 of poses left out.
    """

    problem: ThreeAxisProblem
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

    def covariance_of(self, rows: FloatArray) -> FloatArray:
        """(m, m) of what is linear (m, p) in the parameters."""
        return np.asarray(rows @ self.covariance @ rows.T)

    def covariance_at(self, places: Intp) -> FloatArray:
        """(m, m) of some parameters."""
        return self.covariance[np.ix_(places, places)]

    @property
    def stds(self) -> FloatArray:
        """(p,) standard errors."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def left(self) -> FloatArray:
        """(n,) angle about the stage's axis, measured less expected, rad."""
        seen = self.problem.table
        expected = self.problem.expected_g(self.parameters)
        found = np.zeros(len(seen))
        for k in range(len(seen.mounts)):
            rows = np.flatnonzero(seen.mount == k)
            about = expected[rows] @ face_matrix(self.problem.of.faces[k])
            found[rows] = seen.angle()[rows] - np.arctan2(about[:, 1], about[:, 2])
        return np.asarray(np.angle(np.exp(1j * found)))

    def told(self) -> tuple[int, int]:
        """How many directions of the free parameters the poses tell, and of how many: by singular values.

        A direction is told where it is known better than to a third of how large it may be.
        """
        free = self.problem.free
        scale = self.problem.widths()[free] / self.noise
        size = np.linalg.eigvalsh(self.normal.matrix[np.ix_(free, free)] * np.outer(scale, scale))
        return int((size > 1.0 / UNTOLD**2).sum()), int(free.sum())


def fitted_whole(
    problem: ThreeAxisProblem, weights: FloatArray, start: FloatArray | None = None, *, robust: bool = False
) -> ThreeAxisFit:
    """The least squares solution; arguments as `least_squares.fitted` has them."""
    free, prior = problem.free, problem.widths() ** -2.0
    centre = np.where(free, problem.start(), 0.0)
    parameters = centre if start is None else np.where(free, start, 0.0)
    noise, own = np.inf, weights
    for step in range(STEPS):
        normal = problem.normal(parameters, own)
        noise = _median_noise(normal, weights)
        if robust and step > 1:
            own = weights * _huber(normal, noise)
            normal = problem.normal(parameters, own)
        inverse = _inverse(normal.matrix + np.diag(noise**2 * prior), free)
        change = inverse @ (normal.gradient - noise**2 * prior * (parameters - centre))
        parameters = parameters + change
        errors = noise * np.sqrt(np.maximum(np.diag(inverse), 0.0))
        if not (np.abs(change) > CONVERGED * errors).any():
            break
    normal = problem.normal(parameters, own)
    freedom = max(3.0 * float(weights.sum()) - _share(problem, normal, noise), 1.0)
    if not robust:
        noise = max(float(np.sqrt(normal.squares / freedom)), LEAST_NOISE)
    covariance = noise**2 * _inverse(normal.matrix + np.diag(noise**2 * prior), free)
    return ThreeAxisFit(problem, parameters, covariance, noise, freedom, normal, weights)


def without_outlying_vectors(problem: ThreeAxisProblem) -> tuple[ThreeAxisFit, FloatArray]:
    """The least squares solution without poses that have gone wrong alone, and the weights (n,) of all."""
    size_g = np.linalg.norm(problem.of.vector_g, axis=1)
    return fitted_without_outliers(
        lambda weights, start, robust: fitted_whole(problem, weights, start, robust=robust),
        vector_distances,
        size_g,
    )


def vector_distances(fit: ThreeAxisFit) -> FloatArray:
    """(n,) how far each pose lies from what the others say of it, in standard deviations."""
    inverse = fit.covariance / fit.noise**2
    far = np.linalg.norm(fit.normal.residuals, axis=1) / fit.noise
    for rows, at, derivatives in fit.normal.blocks:
        share = _leverage(inverse, at, derivatives).max(axis=1)
        room = 1.0 - np.where(fit.kept[rows], share, -share)
        far[rows] /= np.sqrt(np.clip(room, 0.05, None))
    return np.asarray(far)


def noise_of_axes(fit: ThreeAxisFit) -> ThreeAxisFit:
    """The same with the noise of each unit's axes told apart."""
    for _ in range(SHAPES):
        problem = fit.problem
        inverse, units = fit.covariance / fit.noise**2, problem.table.unit
        squares, freedom = np.zeros_like(problem.shape), np.zeros_like(problem.shape)
        for rows, at, derivatives in fit.normal.blocks:
            kept = fit.kept[rows]
            unit = int(units[rows[0]])
            squares[unit] += (fit.normal.residuals[rows][kept] ** 2).sum(axis=0)
            freedom[unit] += kept.sum() - _leverage(inverse, at, derivatives[kept]).sum(axis=0)
        noise_g = problem.shape * np.sqrt(squares / np.maximum(freedom, 1.0))
        whole = np.sqrt(np.mean(noise_g**2))
        shape = np.maximum(noise_g / max(whole, LEAST_NOISE), LEAST_SHAPE)
        shape /= np.sqrt(np.mean(shape**2))
        fit = fitted_whole(replace(problem, shape=shape), fit.weights, fit.parameters)
    return fit


def vector_correlation(fit: ThreeAxisFit) -> float:
    """Lag-1 correlation of the poses' noise by restricted likelihood (`correlation`), 0 without an order."""
    from scipy.optimize import minimize_scalar

    if not fit.problem.table.in_order:
        return 0.0
    free, prior = fit.problem.free, np.diag(fit.noise**2 * fit.problem.widths() ** -2.0)

    def criterion(rho: float) -> float:
        normal = replace(fit.problem, correlation=float(rho)).normal(fit.parameters, fit.weights)
        matrix, ahead = (normal.matrix + prior)[np.ix_(free, free)], normal.gradient[free]
        squares = max(normal.squares - float(ahead @ np.linalg.solve(matrix, ahead)), LEAST_SQUARES)
        return float(
            fit.freedom * np.log(squares) + normal.log_variance + float(np.linalg.slogdet(matrix)[1])
        )

    found = minimize_scalar(criterion, bounds=(0.0, LARGEST_CORRELATION), options={"xatol": CLOSE})
    return float(found.x)


def _leverage(inverse: FloatArray, at: Intp, derivatives: FloatArray) -> FloatArray:
    """(n, 3) share of each response that its own measurement has in what is expected of it."""
    return np.asarray(np.einsum("nri,ij,nrj->nr", derivatives, inverse[np.ix_(at, at)], derivatives))


def _share(problem: ThreeAxisProblem, normal: Normal, noise: float) -> float:
    """Parameters that the responses tell: the trace of the matrix that predicts them."""
    known = np.diag(noise**2 * problem.widths() ** -2.0)
    return float((_inverse(normal.matrix + known, problem.free) * normal.matrix).sum())


def _huber(normal: Normal, noise: float) -> FloatArray:
    return np.asarray(HUBER / np.maximum(np.linalg.norm(normal.residuals, axis=1) / noise, HUBER))


def _median_noise(normal: Normal, weights: FloatArray) -> float:
    squares = (normal.residuals**2).sum(axis=1)[weights > 0.0]
    return max(float(np.sqrt(np.median(squares) / MEDIAN_OF_THREE)), LEAST_NOISE)


def _inverse(matrix: FloatArray, free: BoolArray) -> FloatArray:
    """(p, p) of the free parameters' part, 0 elsewhere; scaled, so that units of measure do not matter."""
    scale = 1.0 / np.sqrt(np.diag(matrix)[free])
    whole = np.zeros_like(matrix)
    part = np.linalg.inv(matrix[np.ix_(free, free)] * np.outer(scale, scale))
    whole[np.ix_(free, free)] = part * np.outer(scale, scale)
    return whole


FEWEST_SPARE = 12
"""Responses beside the parameters, which the noise is found from."""
MOST_TILT_DEG = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class ThreeAxisSolution:
    """Stage, mounts and whole units.

    Attributes:
        fit: of the model that the data carry.
        choice: how that model was chosen.
        warnings: what a person should know of the poses.
    """

    fit: ThreeAxisFit
    choice: Choice
    warnings: tuple[str, ...]

    @property
    def of(self) -> ThreeAxisTable:
        """The poses."""
        return self.fit.problem.of

    @property
    def table(self) -> Table:
        """The same as of mounts about x."""
        return self.fit.problem.table

    @property
    def noise_deg(self) -> float:
        """Standard deviation of one pose's angle."""
        return float(np.degrees(self.fit.noise))


def solve_whole(
    lots: Sequence[MountedPoses],
    *,
    linear: bool = False,
    periods_deg: Sequence[float] = (),
    progress: Progress = unheard,
) -> ThreeAxisSolution:
    """Solves stage, mounts and units clamped by several faces at once; arguments as `solution.solve`.

    Raises:
        DiagnosisError: the poses are too few, or cannot be what they are said to be.
    """
    table, warnings = three_axis_table(lots)
    known = [TURN_DEG / period for period in periods_deg]
    shape = np.ones((len(table.seen.units), 3))
    problem = ThreeAxisProblem(table, always(linear, known), linear, shape)
    orders = offered(problem, 3 * len(problem.table), FEWEST_SPARE)
    rich, weights = without_outlying_vectors(replace(problem, orders=orders))
    progress(0.5)
    rich = noise_of_axes(rich)
    correlated = replace(rich.problem, correlation=vector_correlation(rich))
    progress(0.7)
    choice = chosen(fitted_whole(correlated, weights, rich.parameters), known)
    fit = fitted_whole(replace(correlated, orders=choice.orders), weights)
    _refuse_another_face(fit)
    said = outliers_said(table.seen, fit.kept, vector_distances(fit))
    return ThreeAxisSolution(fit, choice, (*warnings, *said))


def _refuse_another_face(fit: ThreeAxisFit) -> None:
    for mount, named in enumerate(fit.problem.table.mounts):
        tilt_deg = float(np.degrees(np.abs(fit.parameters[fit.problem.tilts_at(mount)]).max()))
        if tilt_deg > MOST_TILT_DEG:
            raise DiagnosisError(
                f"mount {named.name} of unit {fit.problem.table.units[named.unit]}: mount_axis is "
                f"{fit.problem.of.faces[mount]}, but that axis lies {tilt_deg:.0f}° from the stage's"
            )
