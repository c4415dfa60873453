"""The model of an accelerometer against gravity, its least squares, and the poses that disagree with it.

The model is linear in its coefficients: true = raw + Σ βₖ·Dₖ(raw, covariates), so that the residual |true| −
1 g has the exact derivative (true/|true|)·Dₖ. The base is an offset and a factor for each axis; effects are
added to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.regression.effect import Origin
from calrig.calibration.static_segments import GravityError, StaticPoses
from calrig.estimation.angles import AXES, BoolArray, FloatArray

MISALIGNMENT = "misalignment"
BASE = 6
PAIRS = ("xy", "xz", "yz")
LEAST_SIGHT = 0.05
"""Smallest singular value of the fit over √poses that determines a parameter; a good log has 0.2."""
LEAST_SIGHT_OF_A_PAIR = 0.01
"""The same for misalignment, where the standard error says the rest; the six faces alone give 0."""
BLIND_SHARE = 0.2
LEAST_TEMPERATURE_RANGE_C = 1.0
ITERATIONS = 50
CONVERGED = 1e-12
LARGEST = 1e3
SHORTEST_G = 1e-9
LEAST_FACTOR = 0.01
"""Of raw to true; a fit with less has turned an axis round."""
FEWEST_POSES = 9
"""Six unknowns, and some degrees of freedom when one pose is left out."""
FREEDOM_TO_JUDGE = 6
"""Degrees of freedom from which on a pose can be compared with the others."""
ROBUST_STEPS = 30
FAR_OFF = 4.0
"""In robust standard deviations: where the comparison of a pose with the others begins."""
BY_CHANCE = 0.01
"""Tables of good poses of which one pose is taken for an outlier."""
GROSS = 10.0
"""Standard deviations. A smaller error may be a heavy tail, and moves a parameter by about its own error."""
NORMAL_QUARTILE = 0.6745
BLOCKS, FEWEST_IN_A_BLOCK, SCATTER = 8, 4, 2.64
"""Parts of a log in time, positions in each, and what their scatter reaches in 1 % by chance, as a variance
over the stated one (χ² of 7 degrees of freedom over 7).
"""


@dataclass(frozen=True, slots=True)
class GravityEffect:
    """What bias and scale of three axes may lack: a catalogue entry, seen by |a| alone.

    Attributes:
        name: where it is one of the catalogue of elevation, the same cause with a parameter for each axis.
        origin, covariate: as CONTRACT section 5 has them.
        columns: (n, 3, 3) what the three parameters add to `true`, (pose, axis, parameter); None where the
            log has no covariate for it. Without unit, of order 1.
        parameters: their names, in the contract's units.
        reported: those values, from coefficients, the diagonal of the matrix and the poses.
        remedy: what a person can do about it.
        reference: of the covariate, by its parameter's name: where what it adds is 0.
    """

    name: str
    title: str
    origin: Origin
    covariate: str
    columns: Callable[[StaticPoses], FloatArray | None]
    parameters: tuple[str, str, str]
    reported: Callable[[FloatArray, FloatArray, StaticPoses], FloatArray]
    remedy: str
    reference: Callable[[StaticPoses], dict[str, float]] = lambda _poses: {}


def _misaligned(poses: StaticPoses) -> FloatArray:
    columns = np.zeros((len(poses), 3, 3))
    columns[:, 0, 0], columns[:, 0, 1], columns[:, 1, 2] = poses.accel_g[:, [1, 2, 2]].T
    return columns


def _warmer(poses: StaticPoses) -> FloatArray | None:
    """(n,) temperature less its mean, over its range."""
    if poses.temperature_c is None or np.ptp(poses.temperature_c) < LEAST_TEMPERATURE_RANGE_C:
        return None
    return np.asarray((poses.temperature_c - poses.temperature_c.mean()) / np.ptp(poses.temperature_c))


def _later(poses: StaticPoses) -> FloatArray | None:
    if poses.time_s is None or np.ptp(poses.time_s) <= 0.0:
        return None
    return np.asarray((poses.time_s - poses.time_s.mean()) / np.ptp(poses.time_s))


def _offsets(share: FloatArray | None) -> FloatArray | None:
    return None if share is None else share[:, None, None] * np.eye(3)


def _factors(share: FloatArray | None, poses: StaticPoses) -> FloatArray | None:
    return None if share is None else (share[:, None] * poses.accel_g)[:, :, None] * np.eye(3)


def _range(values: FloatArray | None) -> float:
    return 1.0 if values is None else float(np.ptp(values))


def _mean(name: str, values: FloatArray | None) -> dict[str, float]:
    return {} if values is None else {name: float(values.mean())}


EFFECTS = (
    GravityEffect(
        MISALIGNMENT,
        "Misalignment of the axes",
        "sensor",
        "attitude",
        _misaligned,
        ("xy_mrad", "xz_mrad", "yz_mrad"),
        lambda beta, diagonal, _: 1e3 * beta / diagonal[[1, 2, 2]],
        "apply the matrix: the three axes are not square to one another",
    ),
    GravityEffect(
        "temperature_bias",
        "Bias that follows temperature",
        "sensor",
        "temperature_c",
        lambda poses: _offsets(_warmer(poses)),
        ("x_mg_per_c", "y_mg_per_c", "z_mg_per_c"),
        lambda beta, diagonal, poses: -1e3 * beta / diagonal / _range(poses.temperature_c),
        "wait until the unit is warm, or move the bias with its own thermometer",
        lambda poses: _mean("reference_c", poses.temperature_c),
    ),
    GravityEffect(
        "temperature_scale",
        "Scale that follows temperature",
        "sensor",
        "temperature_c",
        lambda poses: _factors(_warmer(poses), poses),
        ("x_per_c", "y_per_c", "z_per_c"),
        lambda beta, diagonal, poses: -beta / diagonal / _range(poses.temperature_c),
        "wait until the unit is warm, or move the scale with its own thermometer",
        lambda poses: _mean("reference_c", poses.temperature_c),
    ),
    GravityEffect(
        "time_drift",
        "Drift in time",
        "environment",
        "time_s",
        lambda poses: _offsets(_later(poses)),
        ("x_mg_per_s", "y_mg_per_s", "z_mg_per_s"),
        lambda beta, diagonal, poses: -1e3 * beta / diagonal / _range(poses.time_s),
        "let the unit warm up first, and come back to the first pose at the end",
        lambda poses: _mean("reference_s", poses.time_s),
    ),
)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """n static poses as the fit sees them.

    Attributes:
        raw_g: (n, 3) measured.
        base: (n, 3, 6) what offset and factor of each axis add to `true`.
        columns: (n, 3, 3) of every effect that the log has a covariate for; 0 for pairs of axes whose
            misalignment these poses do not determine.
    """

    raw_g: FloatArray
    base: FloatArray
    columns: dict[str, FloatArray]

    @classmethod
    def of(cls, poses: StaticPoses) -> Problem:
        """The problem that static poses pose."""
        raw = poses.accel_g
        ones = np.broadcast_to(np.eye(3), (len(poses), 3, 3))
        base = np.concatenate([ones, raw[:, :, None] * np.eye(3)], axis=2)
        columns = {effect.name: effect.columns(poses) for effect in EFFECTS}
        known = {name: column for name, column in columns.items() if column is not None}
        return cls(raw, base, known).sighted()

    def __len__(self) -> int:
        return len(self.raw_g)

    def rows(self, chosen: BoolArray) -> Problem:
        """Some of the poses, their covariates measured from the same reference."""
        columns = {name: column[chosen] for name, column in self.columns.items()}
        return Problem(self.raw_g[chosen], self.base[chosen], columns)

    @property
    def undetermined_pairs(self) -> list[str]:
        """Pairs of axes whose misalignment these poses do not determine, such as `xy`."""
        is_there = np.abs(self.columns[MISALIGNMENT]).max(axis=(0, 1)) > 0.0
        return [pair for pair, is_seen in zip(PAIRS, is_there, strict=True) if not is_seen]

    def sighted(self) -> Problem:
        """The same without what these poses do not determine, as some of other poses may not."""
        columns = self.columns[MISALIGNMENT]
        _, seen = linearised(self.raw_g, np.concatenate([self.base, columns], axis=2), np.zeros(BASE))
        basis, _ = np.linalg.qr(seen[:, :BASE])
        left = seen[:, BASE:] - basis @ (basis.T @ seen[:, BASE:])
        _, values, vectors = np.linalg.svd(left, full_matrices=len(left) < len(PAIRS))
        values = np.concatenate([values, np.zeros(len(PAIRS) - len(values))]) / np.sqrt(len(self))
        blind = (vectors[values < LEAST_SIGHT_OF_A_PAIR] ** 2).sum(axis=0) > BLIND_SHARE
        return replace(self, columns={**self.columns, MISALIGNMENT: np.where(blind, 0.0, columns)})

    def shows(self, effect: GravityEffect) -> bool:
        """Whether these poses determine some of an effect's parameters."""
        return effect.name in self.columns and bool(self.columns[effect.name].any())

    def design(self, effects: Sequence[GravityEffect]) -> FloatArray:
        """(n, 3, 6 + 3k) what each coefficient of a model adds to `true`."""
        return np.concatenate([self.base, *(self.columns[effect.name] for effect in effects)], axis=2)

    def errors_g(self, fitted: GravityFit) -> FloatArray:
        """(n,) |true| − 1 g of these poses under a fit, also one of other poses."""
        true = self.raw_g + self.design(fitted.effects) @ fitted.beta
        return np.asarray(np.linalg.norm(true, axis=1) - 1.0, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class GravityFit:
    """A fitted model.

    Attributes:
        effects: those in the model.
        beta: (6 + 3k,) offset and factor less 1 of each axis, then each effect's.
        residual_g: (n,) |true| − 1 g.
        jacobian: (n, 6 + 3k) of the residual.
    """

    effects: tuple[GravityEffect, ...]
    beta: FloatArray
    residual_g: FloatArray
    jacobian: FloatArray

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) upper triangular: true = matrix·(raw − bias)."""
        matrix = np.diag(1.0 + self.beta[3:BASE])
        at = self._place(MISALIGNMENT)
        if at is not None:
            matrix[[0, 0, 1], [1, 2, 2]] = self.beta[at]
        return matrix

    @property
    def bias_g(self) -> FloatArray:
        """(3,) reading where there is nothing to measure, at the mean temperature and time."""
        return np.asarray(-np.linalg.solve(self.matrix, self.beta[:3]), dtype=np.float64)

    @property
    def covariance(self) -> FloatArray:
        """(6 + 3k, 6 + 3k) of `beta`, as of Student's t (JCGM 101:2008, 6.4.9.4).

        The residual variance is itself an estimate, of n − p degrees of freedom. A sensor that wanders over
        the log errs alike in neighbouring positions: where the scores of its `BLOCKS` parts scatter by more
        than those of independent errors, they give the variance (Liang & Zeger, Biometrika 73, 1986).
        """
        n, p = len(self.jacobian), int(self.jacobian.any(axis=0).sum())
        variance = float(self.residual_g @ self.residual_g) / max(n - p - 2, 1)
        inverse = np.linalg.pinv(self.jacobian.T @ self.jacobian)
        stated = variance * inverse
        if n < FEWEST_IN_A_BLOCK * BLOCKS:
            return np.asarray(stated, dtype=np.float64)
        parts = np.array_split(self.jacobian * self.residual_g[:, None], BLOCKS)
        scores = np.stack([part.sum(axis=0) for part in parts]) @ inverse
        by_blocks = BLOCKS / (BLOCKS - 1) * n / max(n - p, 1) * (scores**2).sum(axis=0)
        size = np.diag(stated)
        ratio = np.divide(by_blocks, size, out=np.ones_like(size), where=size > 0.0)
        wider = np.sqrt(np.where(ratio > SCATTER, ratio, 1.0))
        return np.asarray(stated * wider * wider[:, None], dtype=np.float64)

    @property
    def bias_std_g(self) -> FloatArray:
        """(3,) standard errors of `bias_g`, to first order."""
        by_beta = np.zeros((3, len(self.beta)))  # of −matrix·d(bias), from matrix·bias = −β₀
        by_beta[:, :3] = np.eye(3)
        by_beta[:, 3:BASE] = np.diag(self.bias_g)
        at = self._place(MISALIGNMENT)
        if at is not None:
            by_beta[[0, 0, 1], range(at.start, at.stop)] = self.bias_g[[1, 2, 2]]
        of_bias = np.linalg.solve(self.matrix, by_beta)
        return np.asarray(np.sqrt(np.diag(of_bias @ self.covariance @ of_bias.T)), dtype=np.float64)

    @property
    def gain(self) -> FloatArray:
        """(3,) reading of each axis by what it measures; 1 of a perfect one."""
        return np.asarray(1.0 / np.diag(self.matrix), dtype=np.float64)

    @property
    def gain_std(self) -> FloatArray:
        """(3,) standard errors of `gain`, to first order."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[3:BASE]) * self.gain**2, dtype=np.float64)

    def parameters(self, effect: GravityEffect, poses: StaticPoses) -> tuple[FloatArray, FloatArray]:
        """(3,) values and (3,) standard errors of an effect of the model, in the units of their names.

        NaN where the poses do not determine one.
        """
        at = self._place(effect.name)
        if at is None:
            raise ValueError(f"{effect.name} is not in the model")
        is_seen = self.jacobian[:, at].any(axis=0)
        std = np.sqrt(np.where(is_seen, np.diag(self.covariance)[at], np.nan))
        diagonal = np.diag(self.matrix)
        values = np.where(is_seen, self.beta[at], np.nan)
        return effect.reported(values, diagonal, poses), np.abs(effect.reported(std, diagonal, poses))

    def _place(self, name: str) -> slice | None:
        for k, effect in enumerate(self.effects):
            if effect.name == name:
                return slice(BASE + 3 * k, BASE + 3 * k + 3)
        return None


def fit_gravity(problem: Problem, effects: Sequence[GravityEffect] = ()) -> GravityFit:
    """Fit |true| − 1 g over the poses by least squares, with Gauss-Newton from raw = true.

    Raises:
        GravityError: it does not converge.
    """
    columns = problem.design(effects)
    beta = np.zeros(columns.shape[2])
    for _ in range(ITERATIONS):
        residual, jacobian = linearised(problem.raw_g, columns, beta)
        step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
        beta = beta + step
        if np.abs(step).max() < CONVERGED:
            if beta[3:BASE].min() <= LEAST_FACTOR - 1.0:
                break
            return GravityFit(tuple(effects), beta, *linearised(problem.raw_g, columns, beta))
        if np.abs(beta).max() > LARGEST:
            break
    raise GravityError(
        "bias and scale do not converge to |a| = 1 g: the static poses contradict one another (was the "
        "sensor turned or accelerated in some of them, or its range exceeded?)"
    )


def linearised(raw_g: FloatArray, columns: FloatArray, beta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) |true| − 1 g, and (n, p) its derivative by every column; `beta` is of the first of them."""
    true = raw_g + columns[:, :, : len(beta)] @ beta
    norm = np.linalg.norm(true, axis=1)
    direction = true / np.maximum(norm, SHORTEST_G)[:, None]
    return norm - 1.0, np.einsum("na,nap->np", direction, columns)


def undetermined_base(poses: StaticPoses) -> list[str]:
    """What of bias and scale these poses do not determine, such as `bias x`; empty where all is well."""
    size_g = np.linalg.norm(poses.accel_g, axis=1)
    direction = poses.accel_g / np.maximum(size_g, SHORTEST_G)[:, None]
    columns = np.concatenate([direction, direction**2], axis=1)
    _, values, vectors = np.linalg.svd(columns, full_matrices=len(columns) < BASE)
    values = np.concatenate([values, np.zeros(BASE - len(values))]) / np.sqrt(len(poses))
    blind = (vectors[values < LEAST_SIGHT] ** 2).sum(axis=0)
    names = [f"{what} {axis}" for what in ("bias", "scale") for axis in AXES]
    return [name for name, share in zip(names, blind, strict=True) if share > BLIND_SHARE]


def largest_model(problem: Problem) -> tuple[GravityEffect, ...]:
    """Return the effects with which these poses are compared with one another: all that they determine.

    Raises:
        GravityError: bias and scale do not converge.
    """
    effects: list[GravityEffect] = []
    for effect in EFFECTS:
        p = BASE + 3 * len(effects) + 3
        enough = p + FREEDOM_TO_JUDGE if effect.name == MISALIGNMENT else 2 * p
        if problem.shows(effect) and len(problem) >= enough:
            effects.append(effect)
    return tuple(effects)


def robust_scale_g(problem: Problem, effects: Sequence[GravityEffect]) -> tuple[FloatArray, float]:
    """Return (n,) residuals of the least sum of |residual|, and their robust standard deviation.

    Iteratively reweighted least squares; the p smallest residuals, which are 0, are left out of the median.

    Raises:
        GravityError: bias and scale do not converge.
    """
    beta, columns = fit_gravity(problem, effects).beta, problem.design(effects)
    for _ in range(ROBUST_STEPS):
        residual, jacobian = linearised(problem.raw_g, columns, beta)
        size = np.abs(residual)
        root = 1.0 / np.sqrt(np.maximum(size, 1e-3 * float(np.median(size)) + SHORTEST_G))
        beta = beta + np.linalg.lstsq(jacobian * root[:, None], -residual * root, rcond=None)[0]
    residual, _ = linearised(problem.raw_g, columns, beta)
    of_others = np.sort(np.abs(residual))[min(len(beta), len(residual) - 1) :]
    return residual, max(float(np.median(of_others)) / NORMAL_QUARTILE, SHORTEST_G)


def consistent_poses(problem: Problem) -> tuple[BoolArray, FloatArray]:
    """Return (n,) which poses agree with the others, and (n,) residuals in g by the fit of those that agree.

    A pose disagrees if its studentised deleted residual is over 10, and beyond what the largest of n normal
    ones exceeds by chance in one table of a hundred. The comparison begins with the poses near a robust fit,
    so that outliers do not hide one another.

    Raises:
        GravityError: bias and scale do not converge.
    """
    from scipy.special import stdtrit

    effects = largest_model(problem)
    n, p = len(problem), BASE + 3 * len(effects)
    everything = np.ones(n, dtype=np.bool_)
    if n < p + FREEDOM_TO_JUDGE:
        return everything, fit_gravity(problem, effects).residual_g
    residual, scale = robust_scale_g(problem, effects)
    kept = np.abs(residual) <= FAR_OFF * scale
    columns, seen = problem.design(effects), set[bytes]()
    while kept.sum() >= p + FREEDOM_TO_JUDGE and kept.tobytes() not in seen:
        seen.add(kept.tobytes())
        fitted = fit_gravity(problem.rows(kept), effects)
        residual, jacobian = linearised(problem.raw_g, columns, fitted.beta)
        freedom = int(kept.sum()) - p
        variance = max(float(residual[kept] @ residual[kept]) / freedom, SHORTEST_G**2)
        inverse = np.linalg.pinv(jacobian[kept].T @ jacobian[kept])
        leverage = np.einsum("np,pq,nq->n", jacobian, inverse, jacobian)
        without = np.maximum(1.0 - leverage, SHORTEST_G)
        of_kept = residual**2 / (variance * without)
        deleted = of_kept * (freedom - 1) / np.maximum(freedom - of_kept, SHORTEST_G)
        squared = np.where(kept, deleted, residual**2 / (variance * (1.0 + leverage)))
        limit = max(GROSS, float(stdtrit(freedom - 1, 1.0 - BY_CHANCE / (2 * n))))
        kept = np.asarray(squared <= limit**2, dtype=np.bool_)
    return kept, residual
