"""An accelerometer against |a| = 1 g: the model, the effects it may lack, and its fit.

Everything is linear in its coefficients: true = raw + Σ βₖ·Dₖ(raw, covariates), so that the residual
|true| − 1 g has the exact derivative (true/|true|)·Dₖ. The base is an offset and a factor for each axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.effect import Origin
from calrig.calibration.static_detector import BoolArray, GravityError, StaticPoses
from calrig.estimation.angles import AXES, FloatArray

MISALIGNMENT = "misalignment"
BASE = 6
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


@dataclass(frozen=True, slots=True)
class GravityEffect:
    """What bias and scale of three axes may lack: a catalogue entry, seen by |a| alone.

    Attributes:
        name: where it is one of the catalogue of elevation, the same cause with a parameter for each axis.
        title: for a heading.
        origin: as CONTRACT section 5 has them.
        covariate: likewise.
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
    if poses.time_s is None:
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
        columns: (n, 3, 3) of every effect that the log has a covariate for.
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
        return cls(raw, base, {name: column for name, column in columns.items() if column is not None})

    def __len__(self) -> int:
        return len(self.raw_g)

    def rows(self, chosen: BoolArray) -> Problem:
        """Some of the poses, their covariates measured from the same reference."""
        columns = {name: column[chosen] for name, column in self.columns.items()}
        return Problem(self.raw_g[chosen], self.base[chosen], columns)

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

    def parameters(self, effect: GravityEffect, poses: StaticPoses) -> tuple[FloatArray, FloatArray]:
        """(3,) values and (3,) standard errors of an effect of the model, in the units of their names."""
        at = self._place(effect.name)
        if at is None:
            raise ValueError(f"{effect.name} is not in the model")
        n, p = self.jacobian.shape
        variance = float(self.residual_g @ self.residual_g) / max(n - p, 1)
        std = np.sqrt(variance * np.diag(np.linalg.pinv(self.jacobian.T @ self.jacobian))[at])
        diagonal = np.diag(self.matrix)
        return effect.reported(self.beta[at], diagonal, poses), np.abs(effect.reported(std, diagonal, poses))

    def _place(self, name: str) -> slice | None:
        for k, effect in enumerate(self.effects):
            if effect.name == name:
                return slice(BASE + 3 * k, BASE + 3 * k + 3)
        return None


def fit_gravity(problem: Problem, effects: Sequence[GravityEffect] = ()) -> GravityFit:
    """Least squares of |true| − 1 g over the poses, by Gauss-Newton from raw = true.

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
    direction = poses.accel_g / np.linalg.norm(poses.accel_g, axis=1)[:, None]
    _, values, vectors = np.linalg.svd(np.concatenate([direction, direction**2], axis=1))
    values = np.concatenate([values, np.zeros(BASE - len(values))]) / np.sqrt(len(poses))
    blind = (vectors[values < LEAST_SIGHT] ** 2).sum(axis=0)
    names = [f"{what} {axis}" for what in ("bias", "scale") for axis in AXES]
    return [name for name, share in zip(names, blind, strict=True) if share > BLIND_SHARE]


def undetermined_pairs(problem: Problem, base: GravityFit) -> list[str]:
    """Pairs of axes whose misalignment these poses do not determine, such as `xy`."""
    columns = problem.design([e for e in EFFECTS if e.name == MISALIGNMENT])
    _, seen = linearised(problem.raw_g, columns, base.beta)
    basis, _ = np.linalg.qr(base.jacobian)
    _, values, vectors = np.linalg.svd(seen[:, BASE:] - basis @ (basis.T @ seen[:, BASE:]))
    values = np.concatenate([values, np.zeros(3 - len(values))]) / np.sqrt(len(problem))
    blind = (vectors[values < LEAST_SIGHT_OF_A_PAIR] ** 2).sum(axis=0)
    return [pair for pair, share in zip(("xy", "xz", "yz"), blind, strict=True) if share > BLIND_SHARE]
