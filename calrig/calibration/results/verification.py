"""Verify a calibration: test what it leaves of fresh poses against everything that is uncertain in it.

The errors of a verification contain the noise of its poses, the error of the calibration that was applied,
and the difference of the stage's errors in both runs. The test takes all three by generalised least squares,
with noise that may be correlated from pose to pose. Poses outside the calibrated range are not tested.
`python -m tests.studies.verifications` counts false alarms and faults found.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.correlated_errors import correlation_weights
from calrig.calibration.effects import effect_of
from calrig.calibration.line import Line, rms
from calrig.calibration.poses import Pose, of_first_mount
from calrig.calibration.regression.effect import OF_SENSOR, ApplyError
from calrig.calibration.results.correction import (
    WITHIN_SHARE,
    AppliedEffect,
    effects_on_reading_deg,
    felt_elevation_deg,
)
from calrig.calibration.results.pose_errors import (
    angles_deg,
    as_clamped,
    circumstances,
    corrected_residuals_deg,
    readings_left_deg,
)
from calrig.calibration.results.result import FittedResult, apply_calibration
from calrig.estimation.angles import FloatArray
from calrig.model.result import Extremes, Gyro, Reference, ReferenceFigures, Verified

WITHIN_C = 0.5
"""Beyond a calibrated temperature by no more, a pose is inside: it moves the zero-g output of an MPU-6050 by
0.4 mg at most (60 mg over 70 °C, PS-MPU-6000A, 6.2), 0.025°."""
FEWEST_TESTED = 6
"""Poses inside the calibrated range."""
FALSE_ALARMS = 0.01
"""Share of verifications that noise and the stated uncertainties alone call more than noise."""
CLAMPING_STD_DEG = 10.0
"""Of the angle at which a unit is clamped, where the calibration does not know it."""
STEP = 1e-4
"""Of a parameter, relative, for its derivative."""
ROUNDING_DEG = 1e-9
"""Exact readings leave less: of simulated poses, or of such as are rounded to whole steps."""


@dataclass(frozen=True, slots=True)
class CalibrationBasis:
    """The poses that a calibration was fitted to, as its covariance follows from them.

    Attributes:
        design: (n, p) derivatives of the readings by bias, scale, the parameters of its effects, and bias
            and scale of further runs that effects are from.
        error_deg: (n,) readings less what the calibration predicts.
        theta_deg: (n,) elevations.
        noise_deg: standard error of one reading, from within the dwells; None where it is not known.
        n_own: the first columns of the design: bias, scale and the parameters of its effects.
    """

    design: tuple[tuple[float, ...], ...]
    error_deg: tuple[float, ...]
    theta_deg: tuple[float, ...]
    noise_deg: float | None
    n_own: int


@dataclass(frozen=True, slots=True)
class Promise:
    """What a calibration was made of: outside its ranges it promises nothing.

    Attributes:
        range_deg: of its elevations.
        temperature_c: lowest and highest; None where not known.
        basis: its poses; None where they cannot be had, so that the line's covariance stands for them.
        same_stage: whether the stage that verifies it is the one that it was made on.
    """

    range_deg: tuple[float, float]
    temperature_c: tuple[float, float] | None = None
    basis: CalibrationBasis | None = None
    same_stage: bool = True


def basis_of_poses(
    runs: Sequence[Sequence[Pose]],
    line: Line,
    effects: Sequence[AppliedEffect],
    noise_deg: float | None,
    of_rig: Sequence[AppliedEffect] = (),
) -> CalibrationBasis | None:
    """Return the poses behind a calibration; None where they lack what an effect is a function of.

    Args:
        runs: poses of the run that bias and scale are from, then of each other run that an effect is from:
            it has a bias and a scale of its own.
        line: bias and scale of the calibration.
        effects: its effects.
        noise_deg: of the first run.
        of_rig: errors of its rig, which were taken out of its readings as well.
    """
    runs = [of_first_mount(poses) for poses in runs if poses]
    designs, errors = [], []
    try:
        for k, poses in enumerate(runs):
            of_run = _design(poses, line, effects)
            error_deg = readings_left_deg(poses, line, [*effects, *of_rig])
            design = np.zeros((len(poses), of_run.shape[1] + 2 * (len(runs) - 1)))
            design[:, 2 : of_run.shape[1]] = of_run[:, 2:]
            own = 0 if k == 0 else of_run.shape[1] + 2 * (k - 1)
            design[:, own : own + 2] = of_run[:, :2]
            designs.append(design)
            errors.append(error_deg - (0.0 if k == 0 else error_deg.mean()))
    except ApplyError:
        return None
    if not designs or not all(np.isfinite(one).all() for one in (*designs, *errors)):
        return None
    return CalibrationBasis(
        design=tuple(tuple(row) for row in np.concatenate(designs).tolist()),
        error_deg=tuple(np.concatenate(errors).tolist()),
        theta_deg=tuple(pose.theta_deg for poses in runs for pose in poses),
        noise_deg=noise_deg,
        n_own=designs[0].shape[1] - 2 * (len(runs) - 1),
    )


def verify(
    poses: Sequence[Pose],
    gyro: Gyro | None,
    line: Line,
    effects: Sequence[AppliedEffect],
    reference: ReferenceFigures | None,
    promise: Promise | None,
    *,
    clamped_anew: bool = False,
) -> FittedResult:
    """Apply a calibration to fresh poses and test what it leaves of those inside its range.

    Figures that limits are tested on are of the poses inside the range as well; RMS errors are of all poses.
    Arguments and errors as of `apply_calibration`; without `promise` nothing is tested.
    """

    def applied(some: Sequence[Pose]) -> FittedResult:
        return apply_calibration(some, gyro, line, effects, reference, clamped_anew=clamped_anew)

    poses, result = of_first_mount(poses), applied(poses)
    if promise is None:
        return result
    inside = [pose for pose in poses if _is_inside(pose, promise)]
    if len(inside) < FEWEST_TESTED <= len(poses) or not inside:
        verified = _verified(poses, inside, promise)
        return result.model_copy(update={"over_range": None, "verified": verified})
    judged = result if len(inside) == len(poses) else applied(inside)
    if clamped_anew:
        line = as_clamped(inside, line, effects)
    error_deg = corrected_residuals_deg(inside, line, effects)
    verified = _verified(poses, inside, promise).model_copy(
        update={"rms_deg": rms(error_deg) if np.isfinite(error_deg).all() else None}
    )
    if judged.noise_deg and np.isfinite(error_deg).all():
        left_deg = readings_left_deg(inside, line, effects)
        tested = _tested(inside, left_deg, line, effects, reference, promise, judged.noise_deg, clamped_anew)
        verified = verified.model_copy(update=tested)
    return result.model_copy(update={"over_range": judged.over_range, "verified": verified})


def _is_inside(pose: Pose, promise: Promise) -> bool:
    low, high = promise.range_deg
    within_deg = WITHIN_SHARE * (high - low)
    if not low - within_deg <= pose.theta_deg <= high + within_deg:
        return False
    if pose.temperature_c is None or promise.temperature_c is None:
        return True
    coldest, warmest = promise.temperature_c
    return coldest - WITHIN_C <= pose.temperature_c <= warmest + WITHIN_C


def _verified(poses: Sequence[Pose], inside: Sequence[Pose], promise: Promise) -> Verified:
    """Return the ranges of both runs, nothing tested yet."""
    theta = [pose.theta_deg for pose in poses]
    warmth = [pose.temperature_c for pose in poses if pose.temperature_c is not None]
    calibrated_c = promise.temperature_c
    return Verified(
        n_tested=len(inside),
        n_outside=len(poses) - len(inside),
        calibrated_deg=Extremes(min=promise.range_deg[0], max=promise.range_deg[1]),
        measured_deg=Extremes(min=min(theta), max=max(theta)),
        calibrated_c=None if calibrated_c is None else Extremes(min=calibrated_c[0], max=calibrated_c[1]),
        measured_c=Extremes(min=min(warmth), max=max(warmth)) if warmth else None,
    )


def _tested(
    poses: Sequence[Pose],
    left_deg: FloatArray,
    line: Line,
    effects: Sequence[AppliedEffect],
    reference: ReferenceFigures | None,
    promise: Promise,
    noise_deg: float,
    clamped_anew: bool,
) -> dict[str, float | None]:
    """Return the figures of the test of what is left of the readings (n,), for `Verified`."""
    theta, _ = angles_deg(poses)
    scale = line.scale or 1.0
    try:
        design = _design(poses, line, effects)
    except ApplyError:
        design = _design(poses, line, ())
    setting_deg = abs(scale) * reference.std_deg if reference and reference.kind == "setting" else 0.0
    fresh = _Run(design, left_deg, math.hypot(noise_deg, setting_deg))
    basis = promise.basis
    if basis is None:
        covariance = np.zeros((design.shape[1],) * 2)
        covariance[:2, :2] = 0.0 if line.covariance is None else line.covariance
        covariance[0, 0] += CLAMPING_STD_DEG**2 if clamped_anew else 0.0
        return _test(fresh, None, covariance, np.zeros((len(theta), 0)))
    before_deg = np.array(basis.design)
    fresh.design = np.zeros((len(theta), before_deg.shape[1]))
    # errors of the rig that are taken out beside come after the calibration's own effects
    own = design[:, : basis.n_own]
    fresh.design[:, : own.shape[1]] = own
    before = _Run(before_deg, np.array(basis.error_deg), math.hypot(basis.noise_deg or 0.0, setting_deg))
    then = _stage_shapes(np.array(basis.theta_deg), reference)
    now, absorbed = _stage_shapes(theta, reference), fresh.design @ (before.estimator @ then)
    of_stage = now - absorbed if promise.same_stage else np.concatenate([now, absorbed], axis=1)
    return _test(fresh, before, None, scale * of_stage)


class _Run:
    """Poses of a run: derivatives of the readings, (n, p), errors (n,), standard error of one reading."""

    def __init__(self, design: FloatArray, error_deg: FloatArray, noise_deg: float) -> None:
        self.design = design
        self.error_deg = error_deg
        self.noise_deg = noise_deg

    @property
    def estimator(self) -> FloatArray:
        """(p, n) the least-squares estimate of its parameters by its errors."""
        size = np.linalg.norm(self.design, axis=0)
        size[size == 0.0] = 1.0
        return np.asarray(np.linalg.pinv(self.design / size, rcond=1e-8) / size[:, None], dtype=np.float64)

    @property
    def reduced(self) -> FloatArray:
        """(n, rank) orthonormal columns that span the design."""
        size = np.linalg.norm(self.design, axis=0)
        vectors, values, _ = np.linalg.svd(self.design / np.where(size > 0.0, size, 1.0), full_matrices=False)
        return np.asarray(vectors[:, values > 1e-8 * values[0]], dtype=np.float64)

    @property
    def scatters(self) -> bool:
        """Whether more than rounding is left of its errors, which alone says something of a correlation."""
        left_deg = self.error_deg - self.reduced @ (self.reduced.T @ self.error_deg)
        return len(left_deg) > self.reduced.shape[1] and rms(left_deg) > ROUNDING_DEG


def _test(
    fresh: _Run, before: _Run | None, covariance: FloatArray | None, of_stage: FloatArray
) -> dict[str, float | None]:
    """Test the errors of a verification by generalised least squares, integrated over the correlation ρ.

    Given ρ, the errors e of n poses have the covariance V = s²·R + X·C·Xᵀ + B·Bᵀ: R of a first-order
    autoregression, s the noise of a reading, X the derivatives by the parameters of the calibration, C their
    covariance by the noise of its own poses, B the stage. Then eᵀV⁻¹e is χ² of n degrees of freedom (Searle,
    Casella & McCulloch, Variance Components, 1992, appendix S.2). C follows from the larger of that run's
    noise and of what its poses scatter by. The p-value is averaged over ρ, with the restricted likelihoods of
    both runs' residuals as weight (`correlation_weights`). The ratio is the root of the mean of eᵀV⁻¹e/n.

    `against_calibration_p` is of the same errors against the scatter of the calibration's own poses, by F.
    """
    from scipy.special import chdtrc, fdtrc

    runs = [fresh] if before is None else [fresh, before]
    known = [one for one in runs if one.scatters]
    rho, weight, squares = correlation_weights([(one.reduced, one.error_deg) for one in known])
    n = len(fresh.error_deg)
    freedom = 0 if before is None or before not in known else len(before.error_deg) - before.reduced.shape[1]
    scatter_deg = math.sqrt(float(weight @ squares[-1]) / freedom) if freedom > 0 else 0.0
    estimator = None if before is None else before.estimator
    before_deg = 0.0 if before is None else max(before.noise_deg, scatter_deg)
    chi, against = np.empty(len(rho)), np.empty(len(rho))
    for k, one in enumerate(rho):
        if estimator is not None:
            covariance = before_deg**2 * (estimator @ _correlated(estimator.T, float(one)))
        shapes = np.concatenate([fresh.design @ _root(np.asarray(covariance)), of_stage], axis=1)
        chi[k] = _squares(fresh.error_deg, shapes, float(one), fresh.noise_deg)
        against[k] = _squares(fresh.error_deg, shapes, float(one), scatter_deg) if freedom > 0 else 0.0
    ratio = math.sqrt(float(weight @ chi) / n)

    def p_of(factor: float) -> float:
        return float(weight @ chdtrc(n, factor * chi))

    return {
        "ratio": ratio,
        "bound": ratio * math.sqrt(_root_of(p_of)) if ratio > 0.0 else None,
        "p_value": p_of(1.0),
        "correlation": float(weight @ rho),
        "against_calibration_p": float(weight @ fdtrc(n, freedom, against / n)) if freedom > 0 else None,
    }


def _root_of(p_of: Callable[[float], float]) -> float:
    """Return the factor at which the p-value is `FALSE_ALARMS`."""
    low, high = math.log(1e-12), math.log(1e12)
    for _ in range(60):
        middle = (low + high) / 2.0
        low, high = (middle, high) if p_of(math.exp(middle)) > FALSE_ALARMS else (low, middle)
    return math.exp(low)


def _squares(error_deg: FloatArray, shapes: FloatArray, rho: float, noise_deg: float) -> float:
    """Return eᵀ(s²·R + U·Uᵀ)⁻¹e, by Woodbury's identity."""
    e, u = whitened(error_deg[:, None], rho)[:, 0] / noise_deg, whitened(shapes, rho) / noise_deg
    beside = u.T @ e
    return float(e @ e - beside @ np.linalg.solve(np.eye(u.shape[1]) + u.T @ u, beside))


def whitened(columns: FloatArray, rho: float) -> FloatArray:
    """Return columns whose squares are those by R⁻¹ of a first-order autoregression."""
    white = columns.copy()
    white[1:] = (columns[1:] - rho * columns[:-1]) / math.sqrt(1.0 - rho * rho)
    return white


def _correlated(columns: FloatArray, rho: float) -> FloatArray:
    """Return R·columns, R of a first-order autoregression, without the (n, n) matrix."""
    from scipy.signal import lfilter

    before, after = (lfilter([1.0], [1.0, -rho], some, axis=0) for some in (columns, columns[::-1]))
    return np.asarray(before + after[::-1] - columns, dtype=np.float64)


def _root(covariance: FloatArray) -> FloatArray:
    """Return a matrix U with U·Uᵀ = covariance, whose parameters may differ in size by many powers of ten."""
    size = np.sqrt(np.diag(covariance))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    return np.asarray(size[:, None] * vectors * np.sqrt(np.clip(values, 0.0, None)), dtype=np.float64)


def _stage_shapes(theta_deg: FloatArray, reference: ReferenceFigures | None) -> FloatArray:
    """(n, m) errors of the stage that poses share, each of standard deviation 1 times its column."""
    if reference is None or reference.kind == "setting":
        return np.zeros((len(theta_deg), 0))
    of: Reference = reference.reference
    ones, angle = np.ones(len(theta_deg)), np.radians(theta_deg)
    if of.line_covariance is not None:
        return np.column_stack([ones, theta_deg]) @ _root(np.array(of.line_covariance))
    if of.kind == "harmonic":
        return of.std_deg * np.column_stack([np.sin(angle), np.cos(angle)])
    return of.std_deg * ones[:, None]


def _design(poses: Sequence[Pose], line: Line, effects: Sequence[AppliedEffect]) -> FloatArray:
    """Return (n, 2 + parameters) derivatives of the readings by bias, scale and parameters of the effects.

    References and flags are no parameters: they were chosen, not estimated.

    Raises:
        ApplyError: the poses lack what an effect is a function of.
    """
    theta, _ = angles_deg(poses)
    given = circumstances(poses)
    felt = felt_elevation_deg(theta, line.bias_deg, line.scale)
    columns = [np.ones(len(theta)), theta]
    for k, (name, parameters) in enumerate(effects):
        chosen = {one.name for one in effect_of(name).parameters if one.flag} | {OF_SENSOR}
        for parameter, value in parameters.items():
            if parameter in chosen or parameter.startswith("reference"):
                continue
            step = STEP * (abs(value) or 1.0)
            ends = []
            for moved in (value + step, value - step):
                other = [*effects]
                other[k] = (name, {**parameters, parameter: moved})
                ends.append(effects_on_reading_deg(other, theta, given, felt))
            columns.append((ends[0] - ends[1]) / (2.0 * step))
    design = np.column_stack(columns)
    return np.where(np.isfinite(design), design, 0.0)


def of_line_alone(promise: Promise | None) -> Promise | None:
    """Return the promise of a calibration whose effects cannot be applied: its line's covariance."""
    return None if promise is None else replace(promise, basis=None)
