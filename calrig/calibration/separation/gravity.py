"""Calibrate an accelerometer against gravity alone, without a stage: |a| = 1 g.

The model is linear in its coefficients: true = raw + Σ βₖ·Dₖ(raw, covariates), so that the residual |true| −
1 g has the exact derivative (true/|true|)·Dₖ. The base is an offset and a factor for each axis; effects are
added by forward selection. The statistic is the maximum over all candidates, its null distribution a
bootstrap under the current model for these very poses, as in the diagnosis. Poses laid down by hand come in
any order, so that an effect's columns are rough, and correlation from pose to pose does not resemble one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.diagnosis.candidate_fits import MARGIN
from calrig.calibration.line import rms
from calrig.calibration.regression.effect import Origin
from calrig.calibration.static_detector import BoolArray, GravityError, StaticPoses, static_poses
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
        covariate: as CONTRACT section 5 has them.
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


FREEDOM = 3
"""Degrees of freedom that must be left beside a candidate."""
WIDTH = 3
"""Parameters of every candidate: one for each axis or pair of axes."""
LEVEL = 0.01
BOOTSTRAPS_HELD_OUT = 499
LEAST_FREEDOM_OF_A_POSE = 0.05
SMALLEST = 1e-12
LEAST_SHARE = 1e-7
"""Of a column's size, beyond which it is its own: the root of what a number is rounded to, and more."""


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An effect the gate let through, its family-wise p-value, and the names as likely as its own."""

    effect: GravityEffect
    p_value: float
    rivals: tuple[str, ...]


def poses_needed(fitted: GravityFit) -> int:
    """How many poses it takes to look for one more effect."""
    return len(fitted.beta) + WIDTH + FREEDOM


def search(
    problem: Problem, base: GravityFit, rng: np.random.Generator, bootstraps: int
) -> tuple[GravityFit, tuple[FoundEffect, ...]]:
    """Adds effects to a fit of bias and scale one by one, until the gate lets nothing more through."""
    found: list[FoundEffect] = []
    fitted = base
    blind = undetermined_pairs(problem, base)
    offered = [e for e in EFFECTS if e.name in problem.columns and (e.name != MISALIGNMENT or not blind)]
    while offered and len(problem) >= poses_needed(fitted):
        ratios, p_value = _gate(problem, fitted, offered, rng, bootstraps)
        if p_value > LEVEL:
            break
        best = offered[int(np.argmax(ratios))]
        rivals = [
            effect.name
            for effect, ratio in zip(offered, ratios, strict=True)
            if effect is not best and ratios.max() - ratio < MARGIN
        ]
        found.append(FoundEffect(best, p_value, tuple(rivals)))
        offered.remove(best)
        fitted = fit_gravity(problem, [f.effect for f in found])
    return fitted, tuple(found)


def _gate(
    problem: Problem,
    fitted: GravityFit,
    candidates: Sequence[GravityEffect],
    rng: np.random.Generator,
    bootstraps: int,
) -> tuple[FloatArray, float]:
    """(C,) reductions of −2 log likelihood, and the p-value of their maximum in noise alone.

    Linear about the fit: residuals of a few mg leave terms of second order near 1e-5. The noise is drawn from
    the residuals, each freed of what the fit took from it (Davison & Hinkley, Bootstrap Methods and their
    Application, 1997, section 6.3), with random signs.
    """
    n, taken = len(problem), len(fitted.beta)
    basis, _ = np.linalg.qr(fitted.jacobian)
    leverage = (basis**2).sum(axis=1)
    noise = fitted.residual_g / np.sqrt(np.maximum(1.0 - leverage, LEAST_FREEDOM_OF_A_POSE))
    rounding_g = n * np.finfo(np.float64).eps * float(np.linalg.norm(problem.raw_g, axis=1).max())
    if np.sqrt((noise**2).mean()) < rounding_g:  # a log without noise: what is left is rounding
        noise = np.full(n, rounding_g)
    drawn = noise[rng.integers(0, n, (bootstraps, n))] * rng.choice([-1.0, 1.0], (bootstraps, n))
    values = np.vstack([fitted.residual_g, drawn])
    values = values - (values @ basis) @ basis.T
    power = (values**2).sum(axis=1) + n * rounding_g**2
    columns = problem.design([*fitted.effects, *candidates])
    _, seen = linearised(problem.raw_g, columns, fitted.beta)
    ratios = np.zeros((bootstraps + 1, len(candidates)))
    for k in range(len(candidates)):
        own = seen[:, taken + WIDTH * k : taken + WIDTH * (k + 1)]
        more = _beside(basis, own)
        left = power - ((values @ more) ** 2).sum(axis=1)
        ratios[:, k] = (n - taken - WIDTH) * np.log(power / np.maximum(left, SMALLEST * power))
    best = ratios.max(axis=1)
    return ratios[0], float((1 + (best[1:] >= best[0]).sum()) / (bootstraps + 1))


def _beside(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """Orthonormal columns for what an orthonormal basis has not; what it has, but for rounding, is none."""
    left = columns - basis @ (basis.T @ columns)
    left = left - basis @ (basis.T @ left)  # once more: what the first subtraction left by rounding
    turned, values, _ = np.linalg.svd(left, full_matrices=False)
    return np.asarray(turned[:, values > LEAST_SHARE * np.linalg.norm(columns, 2)], dtype=np.float64)


def leave_one_out(problem: Problem, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """(n,) errors in g before and after: search and fit are repeated without each pose in turn."""
    n = len(problem)
    before, after = np.zeros(n), np.zeros(n)
    for k in range(n):
        one = np.arange(n) == k
        others = problem.rows(~one)
        base = fit_gravity(others)
        final, _ = search(others, base, rng, BOOTSTRAPS_HELD_OUT)
        before[one], after[one] = (problem.rows(one).errors_g(fitted) for fitted in (base, final))
    return before, after


__all__ = ["Gravity", "GravityError", "calibrate_by_gravity", "gravity_document", "trace_gravity"]

FEWEST_POSES = 9
"""Six unknowns, and something left to judge them by when one pose is left out."""
BOOTSTRAPS = 999
SEED = 0
NEAR_1_G = (0.75, 1.25)
MG = 1e3
ALIKE = 0.2
UNITS = {
    9.80665: "m/s²: name the columns accel_x_mps2, accel_y_mps2, accel_z_mps2",
    1.0 / 9.80665: "g in columns named _mps2: name them accel_x_g, accel_y_g, accel_z_g",
    1000.0: "mg: divide them by 1000",
    16384.0: "counts of ±2 g: name the columns accel_x_lsb, … and give the range 2",
    8192.0: "counts of ±4 g: name the columns accel_x_lsb, … and give the range 4",
    4096.0: "counts of ±8 g: name the columns accel_x_lsb, … and give the range 8",
    2048.0: "counts of ±16 g: name the columns accel_x_lsb, … and give the range 16",
    0.25: "counts of a range four times as large: check the range",
    0.5: "counts of a range twice as large: check the range",
    2.0: "counts of a range half as large: check the range",
    4.0: "counts of a range a quarter as large: check the range",
}


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """What gravity says of an accelerometer; held-out errors (n,) in g, each pose by a search without it."""

    poses: StaticPoses
    base: GravityFit
    final: GravityFit
    found: tuple[FoundEffect, ...]
    base_held_out_g: FloatArray
    final_held_out_g: FloatArray
    warnings: tuple[str, ...]


def calibrate_by_gravity(
    accel_g: FloatArray,
    *,
    time_s: FloatArray | None = None,
    gyro_dps: FloatArray | None = None,
    temperature_c: FloatArray | None = None,
) -> Gravity:
    """Calibrates an accelerometer from a log in which it was laid down in many attitudes by hand.

    Args:
        accel_g: (N, 3) samples in g; rows that are not finite are left out.
        time_s: (N,) increasing.
        gyro_dps: (N, 3), helps to tell static from moving.
        temperature_c: (N,) °C.

    Raises:
        GravityError: no motion, too few static poses, poses that do not determine bias and scale, or values
            that are not g.
    """
    whole = np.isfinite(accel_g).all(axis=1)
    if not whole.any():
        raise GravityError("the log has no sample in which all three axes of the accelerometer are known")
    kept = [None if c is None else c[whole] for c in (time_s, gyro_dps, temperature_c)]
    _refuse_other_units(accel_g[whole])
    poses = static_poses(accel_g[whole], time_s=kept[0], gyro_dps=kept[1], temperature_c=kept[2])
    lost = int((~whole).sum())
    said = (f"{lost} samples without all three axes were left out",) if lost else ()
    return trace_gravity(poses, warnings=said)


def trace_gravity(
    poses: StaticPoses, *, bootstraps: int = BOOTSTRAPS, warnings: tuple[str, ...] = ()
) -> Gravity:
    """Fits bias and scale to static poses, then finds what they lack, with family-wise p-values.

    Raises:
        GravityError: too few poses, or poses that do not determine bias and scale.
    """
    _refuse_what_determines_nothing(poses)
    rng = np.random.default_rng(SEED)
    problem = Problem.of(poses)
    base = fit_gravity(problem)
    final, found = search(problem, base, rng, bootstraps)
    before, after = leave_one_out(problem, rng)
    return Gravity(poses, base, final, found, before, after, (*warnings, *_undetermined(problem, base)))


def gravity_document(gravity: Gravity) -> dict[str, Any]:
    """CONTRACT section 7's `calrig gravity --json`, with `warnings` beside it."""
    base, final, n = gravity.base, gravity.final, len(gravity.poses)
    effects = [_effect_document(gravity, found) for found in gravity.found]
    verdicts = [effect["verdict"] for effect in effects]
    return {
        "n_poses": n,
        "held_out": {"how": "leave one pose out", "n_poses": n},
        "base": {
            "bias_g": base.bias_g.tolist(),
            "scale": (1.0 / np.diag(base.matrix)).tolist(),
            "fit_rms_mg": MG * rms(base.residual_g),
            "held_out_rms_mg": MG * rms(gravity.base_held_out_g),
        },
        "verdict": "nothing" if not verdicts else "ambiguous" if "ambiguous" in verdicts else "named",
        "effects": effects,
        "final": {
            "bias_g": final.bias_g.tolist(),
            "matrix": final.matrix.tolist(),
            "fit_rms_mg": MG * rms(final.residual_g),
            "held_out_rms_mg": MG * rms(gravity.final_held_out_g),
        },
        "warnings": list(gravity.warnings),
    }


def _effect_document(gravity: Gravity, found: FoundEffect) -> dict[str, Any]:
    effect, poses = found.effect, gravity.poses
    values, stds = gravity.final.parameters(effect, poses)
    parameters: dict[str, dict[str, float | None]] = {
        name: {"value": float(value), "std": float(std)}
        for name, value, std in zip(effect.parameters, values, stds, strict=True)
    }
    parameters |= {name: {"value": value, "std": None} for name, value in effect.reference(poses).items()}
    return {
        "name": effect.name,
        "title": effect.title,
        "verdict": "ambiguous" if found.rivals else "named",
        "origin": effect.origin,
        "covariate": effect.covariate,
        "parameters": parameters,
        "p_value": found.p_value,
        "confusable_with": list(found.rivals),
        "remedy": effect.remedy,
    }


def _refuse_what_determines_nothing(poses: StaticPoses) -> None:
    n = len(poses)
    if n == 1:
        raise GravityError(
            "the log is one static pose: nothing was turned; lay the sensor down in "
            f"{FEWEST_POSES} or more attitudes, on every side and on edges, a few seconds each"
        )
    if n < FEWEST_POSES:
        raise GravityError(
            f"{n} static poses are too few: at least {FEWEST_POSES} are needed (six unknowns, and something "
            "to judge them by), each at rest for two seconds and more"
        )
    blind = undetermined_base(poses)
    if blind:
        raise GravityError(
            f"the {n} static poses do not determine {', '.join(blind)}: lay the sensor down with "
            f"{_both_ways({name[-1] for name in blind})} as well"
        )


def _both_ways(axes: set[str]) -> str:
    return ", ".join(f"{axis} up and {axis} down" for axis in sorted(axes))


def _undetermined(problem: Problem, base: GravityFit) -> list[str]:
    """What these poses cannot show, in words."""
    pairs = undetermined_pairs(problem, base)
    said = []
    if pairs:
        said.append(
            f"misalignment {', '.join(pairs)} cannot be seen and was not looked for: tilt the sensor "
            f"between {', '.join(f'{pair[0]} and {pair[1]}' for pair in pairs)} in some poses"
        )
    elif len(problem) < poses_needed(base):
        said.append(f"{len(problem)} static poses do not show misalignment: {poses_needed(base)} are needed")
    return said


def _refuse_other_units(accel_g: FloatArray) -> None:
    """|a| of the middle sample is near 1 g, whatever the attitude, or the values are of another unit."""
    size = float(np.median(np.linalg.norm(accel_g, axis=1)))
    if NEAR_1_G[0] <= size <= NEAR_1_G[1]:
        return
    looks = next((words for about, words in UNITS.items() if abs(size / about - 1.0) < ALIKE), None)
    hint = f"the values look like {looks}" if looks else "check the unit and the range"
    raise GravityError(f"|a| is {size:.4g} g in the middle of the log where gravity is 1 g: {hint}")
