"""Bias and scale by least squares: reading = bias + scale·θ, with what they are worth."""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field, InstanceOf

from calrig.calibration.correlated_errors import covariance_over_correlations
from calrig.estimation.angles import BoolArray, FloatArray, Intp, robust_std, wrap_deg

MIN_SCALE = 1e-6
"""A smaller one says that the reading does not follow the stage: there is nothing to divide by."""
HALF, STDS = 0.5, 3.0
"""Nor does one that noise may have made: below a half, and within so many standard errors of 0."""
FARTHEST_STD_DEG = 60.0
"""Nor do readings that scatter by more about the line: modulo a turn, those at random scatter by 104°, and on
which turn one of them is meant nobody knows."""
OPPOSED = 0.1
"""By how much more readings of a sensor that counts against the stage must agree on one direction."""
HALF_TURN_DEG, TURN_DEG, HOLE_DEG = 180.0, 360.0, 90.0
"""A circle of targets may be cut where so much of it or more has none."""
DECISIVE = 10.0
"""In −2 log likelihood, by which one line fits better than another (Kass & Raftery, Journal of the American
Statistical Association 90, 1995: "very strong")."""
EXACT_DEG = 1e-6
"""What rounding leaves of readings that follow a line exactly."""
GROSS_SHARE, STRAYS = 0.1, 10.0
"""Of the readings, the most that may be gross errors; robust standard deviations beyond which they are."""
FAR, FEWEST_SPREAD = 12.0, 10
"""Robust standard deviations from what the other poses say; the fewest poses that have one."""

Matrix2 = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class JointErrors:
    """Errors of bias, scale and the parameters of the unit's effects, as steps that are independent.

    Bias and scale hide most of an error of an eccentricity or a nonlinearity: of a calibrated elevation all
    errors are far smaller together than each is by itself.

    Attributes:
        parameters: of effects, each with the place of its effect among those of the unit.
        steps: (q, 2 + p) of bias, scale and parameters; their covariance is stepsᵀ·steps.
        elevation_deg: (q, n) what each step makes of the calibrated elevation at each pose.
        mean_variance_deg2: the mean over the range of the squares' sum.
    """

    parameters: tuple[tuple[int, str], ...]
    steps: FloatArray
    elevation_deg: FloatArray
    mean_variance_deg2: float


@dataclass(frozen=True, slots=True)
class Line:
    """A fitted line; what the poses do not tell is None.

    Attributes:
        bias_deg: reading at θ = 0; with all poses at one angle, mean of reading − θ; in (−180, 180] unless
            readings go beyond half a turn and are on one turn with it.
        scale: None with all poses at one angle; counts as 1 then.
        bias_std_deg, scale_std: standard errors; noise may be correlated from pose to pose, here and below.
        covariance: of bias (deg) and scale; None without a scale or without degrees of freedom.
        residual_std_deg: standard deviation of a reading about the true line.
        effect_parameters: of effects, fitted to the same poses in addition; each takes a degree of freedom.
        slope: by how much a reading grows per degree of elevation, where curves of the unit make that another
            than the scale: its inverse square is the mean of the poses'.
        errors: of the line together with the unit's effects, in this process; None where these have no
            standard errors.
    """

    bias_deg: float
    scale: float | None
    bias_std_deg: float | None
    scale_std: float | None
    covariance: Matrix2 | None
    residual_std_deg: float | None
    effect_parameters: int = 0
    slope: float | None = None
    errors: Annotated[InstanceOf[JointErrors] | None, Field(exclude=True)] = field(
        default=None, compare=False, repr=False
    )

    @property
    def follows(self) -> bool:
        """Whether the reading follows the stage, so that errors of readings are errors of an elevation."""
        scale = 1.0 if self.scale is None else self.scale
        return bool(follows_stage(scale, self.scale_std or 0.0, self.residual_std_deg or 0.0))

    def left_deg(self, theta_deg: FloatArray, reading_deg: FloatArray) -> FloatArray:
        """(n,) `residuals_deg` of readings; NaN throughout where they do not follow the stage."""
        if not self.follows:
            return np.full(len(theta_deg), math.nan)
        return residuals_deg(theta_deg, reading_deg, self.bias_deg, self.scale)


def follows_stage(scale: npt.ArrayLike, scale_std: npt.ArrayLike, left_deg: npt.ArrayLike) -> BoolArray:
    """Whether readings of these fitted scales, which leave so much (RMS), follow the stage."""
    size = np.abs(scale)
    may_be_noise = size < np.minimum(HALF, np.multiply(STDS, scale_std))
    return np.asarray((size >= MIN_SCALE) & ~may_be_noise & (np.asarray(left_deg) < FARTHEST_STD_DEG))


def fit_line(
    theta_deg: FloatArray, reading_deg: FloatArray, *, one_angle: bool = False, doubts: bool = True
) -> Line:
    """Fit bias and scale to reading − θ, so that a turn more or less does not matter.

    Ordinary least squares about the mean of θ (Draper & Smith, Applied Regression Analysis, 1998, section
    1.4; GUM H.3). Standard errors allow for noise that is correlated from pose to pose
    (`covariance_over_correlations`), with n − 2 (or n − 1) degrees of freedom.

    Args:
        theta_deg: (n,) elevation of the stage, n >= 1, in the order measured.
        reading_deg: (n,) readings.
        one_angle: the poses were all commanded to one angle: what θ scatters by is then the stage's
            noise and says nothing of a scale. All θ equal is seen without being told.
        doubts: whether to tell what they are worth, too, which takes as long again.

    Raises:
        ValueError: no pose, shapes that differ, or a number that is not finite.
    """
    if theta_deg.shape != reading_deg.shape or theta_deg.ndim != 1 or len(theta_deg) == 0:
        raise ValueError(f"a fit needs poses: {theta_deg.shape} angles, {reading_deg.shape} readings")
    if not (np.isfinite(theta_deg).all() and np.isfinite(reading_deg).all()):
        raise ValueError("a pose's angle or reading is not finite")
    error = reading_error_deg(theta_deg, reading_deg)
    n = len(error)
    if one_angle or np.ptp(theta_deg) == 0.0:
        level = float(error.mean())
        bias = float(bias_on_turn_deg(level, theta_deg, reading_deg, error))
        if n < 2 or not doubts:
            return Line(bias, None, None, None, None, None)
        covariance, variance = covariance_over_correlations(np.ones((n, 1)), error - level)
        return Line(bias, None, math.sqrt(covariance[0, 0]), None, None, math.sqrt(variance))
    centre = float(theta_deg.mean())
    theta = theta_deg - centre
    slope = float(theta @ error) / float(theta @ theta)
    level = float(error.mean())
    bias = float(bias_on_turn_deg(level - slope * centre, theta_deg, reading_deg, error))
    if n < 3 or not doubts:
        return Line(bias, 1.0 + slope, None, None, None, None)
    unit_deg = float(np.abs(theta).max())
    design = np.column_stack([np.ones(n), theta / unit_deg])
    of_design, variance = covariance_over_correlations(design, error - level - slope * theta)
    to_line = np.array([[1.0, -centre / unit_deg], [0.0, 1.0 / unit_deg]])
    covariance = to_line @ of_design @ to_line.T
    (bias_variance, shared), (_, scale_variance) = covariance.tolist()
    bias_variance = max(bias_variance, 0.0)  # of exact readings the residual is rounding, and so is its sign
    return Line(
        bias_deg=bias,
        scale=1.0 + slope,
        bias_std_deg=math.sqrt(bias_variance),
        scale_std=math.sqrt(scale_variance),
        covariance=((bias_variance, shared), (shared, scale_variance)),
        residual_std_deg=math.sqrt(variance),
    )


def reading_error_deg(theta_deg: FloatArray, reading_deg: FloatArray) -> FloatArray:
    """Return (…, n) reading − θ in degrees, each reading on the turn on which it follows the others of its n.

    Each alone in (−180, 180] would tear a unit mounted upside down apart, at +179.9° here and −179.9° there,
    and readings within half a turn of θ would tear those of a sensor that counts against the stage. Readings
    beyond half a turn that are all on one turn stay on it, and so do gross errors of those that go on over
    several turns.
    """
    (along, agree), (against, disagree) = (_on_one_turn(reading_deg - way * theta_deg) for way in (1.0, -1.0))
    error = np.where(disagree > agree + OPPOSED, against - 2.0 * theta_deg, along)
    for row in np.ndindex(error.shape[:-1]):
        theta, reading = theta_deg[row], reading_deg[row]
        turns = np.rint((reading - theta - error[row]) / TURN_DEG)
        usual = turns == np.median(turns)
        if usual.all():
            error[row] += TURN_DEG * turns * (np.abs(reading).max() > HALF_TURN_DEG)
        elif _go_on(reading, usual):
            off = theta - theta[usual].mean()
            slope = (off @ (error[row] * usual)) / (off @ (off * usual))
            if _strays(error[row] - slope * off, usual):
                error[row] = reading - theta
    return error


def bias_on_turn_deg(
    bias_deg: float | FloatArray, theta_deg: FloatArray, reading_deg: FloatArray, error_deg: FloatArray
) -> FloatArray:
    """Return (…) a bias as errors (…, n) gave it, if readings are beyond half a turn and on one turn with it.

    It is in (−180, 180] otherwise.
    """
    is_on_one = (np.abs(reading_deg - theta_deg - error_deg) <= HALF_TURN_DEG).all(axis=-1)
    is_beyond = np.abs(reading_deg).max(axis=-1) > HALF_TURN_DEG
    return np.where(is_on_one & is_beyond, bias_deg, wrap_deg(bias_deg))


def _go_on(reading_deg: FloatArray, usual: BoolArray) -> bool:
    """Return whether nearly all (n,) readings are on their usual turn, and span more than a turn there."""
    return bool(usual.mean() >= 1.0 - GROSS_SHARE and np.ptp(reading_deg[usual]) > TURN_DEG)


def _strays(left_deg: FloatArray, usual: BoolArray) -> bool:
    """Return whether readings of another turn, once on the usual one, are still not where the others are."""
    middle_deg, spread_deg = np.median(left_deg[usual]), robust_std(left_deg[usual])
    away_deg = np.median(np.abs(left_deg[~usual] - middle_deg))
    return bool(away_deg > STRAYS * max(spread_deg, EXACT_DEG))


def cut_above_deg(target_deg: FloatArray, reading_deg: FloatArray) -> float | None:
    """Return the target above which targets are better less by 360°; None where they are as good as written.

    Targets from −30° to 30° may be written as 330° to 360° and 0° to 30°: they leave a hole, and the readings
    follow a line with the circle cut there. Those of an axis that did turn to 330° follow it as written.
    Where readings do not decide, the rows do: an axis that goes on from 358° to 2° has turned by 4°.

    Args:
        target_deg: (n,) in the order of the rows.
        reading_deg: (n,) beside them.
    """
    known = np.unique(target_deg)
    span_deg = known[-1] - known[0] if len(known) else 0.0
    if not TURN_DEG - HOLE_DEG < span_deg <= TURN_DEG:
        return None
    hole = int(np.argmax(np.diff(known)))
    if known[hole + 1] - known[hole] < HOLE_DEG:
        return None
    cut_deg = target_deg - TURN_DEG * (target_deg > known[hole])
    as_written, cut = (
        np.sum(np.square(error - np.polyval(np.polyfit(theta, error, 1), theta))) + EXACT_DEG**2
        for theta in (target_deg, cut_deg)
        for error in [reading_error_deg(theta, reading_deg)]
    )
    better = len(target_deg) * math.log(as_written / cut)
    steps_deg, cut_steps_deg = np.abs(np.diff(target_deg)), np.abs(np.diff(cut_deg))
    is_over, is_usual = steps_deg > HALF_TURN_DEG, (steps_deg > 0.0) & (steps_deg <= HALF_TURN_DEG)
    is_going_on = False
    if is_over.any() and is_usual.any():
        least_deg, usual_deg = np.quantile(steps_deg[is_usual], (0.0, 0.5)).tolist()
        is_sweep = usual_deg <= 1.5 * least_deg  # of rows in random order any step may be small
        is_going_on = is_sweep and float(cut_steps_deg[is_over].min()) <= 2.0 * usual_deg
    return float(known[hole]) if better > (-DECISIVE if is_going_on else DECISIVE) else None


def off_robust_line_deg(theta_deg: FloatArray, value_deg: FloatArray) -> FloatArray:
    """Return (n,) values less their line by the median slope between poses half of all apart.

    It is that of Theil (Proc. Kon. Ned. Akad. v. Wetensch. A 53, 1950) by fewer pairs.
    """
    order, half = np.argsort(theta_deg, kind="stable"), len(theta_deg) // 2
    apart_deg, rise_deg = (one[order[-half:]] - one[order[:half]] for one in (theta_deg, value_deg))
    slopes = rise_deg[apart_deg > 0.0] / apart_deg[apart_deg > 0.0]
    left_deg = value_deg - (np.median(slopes) if len(slopes) else 0.0) * theta_deg
    return np.asarray(left_deg - np.median(left_deg))


def strays(theta_deg: FloatArray, reading_deg: FloatArray, left_deg: FloatArray) -> Intp:
    """Return the poses that are far from the line of the others, alone in time and at their angle.

    None of fewer than `FEWEST_SPREAD`; none where more than `GROSS_SHARE` are far: the model is wrong then.

    Args:
        theta_deg: (n,) elevations in the order measured.
        reading_deg: (n,) readings; their resolution is the least spread.
        left_deg: (n,) what calibration leaves of them.
    """
    if len(theta_deg) < FEWEST_SPREAD or np.isnan(left_deg).any():
        return np.empty(0, dtype=np.intp)
    off_deg = off_robust_line_deg(theta_deg, left_deg)
    steps_deg = np.diff(np.unique(reading_deg))
    spread_deg = max(robust_std(off_deg), steps_deg[steps_deg > EXACT_DEG].min(initial=TURN_DEG))
    far = np.abs(off_deg) > FAR * spread_deg
    if far.mean() > GROSS_SHARE:
        return np.empty(0, dtype=np.intp)
    beside = np.convolve(far, [1, 0, 1])[1:-1] > 0
    beside[0] |= far[0]  # where play is taken up
    near_deg, others_deg = np.median(np.abs(np.diff(theta_deg))), np.sort(theta_deg[far])
    first = np.searchsorted(others_deg, theta_deg - near_deg, "left")
    last = np.searchsorted(others_deg, theta_deg + near_deg, "right")
    return np.flatnonzero(far & ~beside & (last - first == 1))


def _on_one_turn(angle_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (…, n) angles within half a turn of their common direction; how far they agree on it, 0 to 1."""
    mean = np.exp(1j * np.radians(angle_deg)).mean(axis=-1, keepdims=True)
    common = np.degrees(np.angle(mean))
    return np.asarray(wrap_deg(angle_deg - common) + common), np.abs(mean)


def residuals_deg(
    theta_deg: FloatArray, reading_deg: FloatArray, bias_deg: float, scale: float | None
) -> FloatArray:
    """(n,) what is left after calibration: (reading − bias)/scale − θ in degrees; scale None counts as 1.

    The reading is taken on the turn on which the calibrated one comes nearest to θ, except for gross errors
    of readings that go on over several turns. NaN throughout where the scale is smaller than `MIN_SCALE`.
    """
    factor = 1.0 if scale is None else scale
    if abs(factor) < MIN_SCALE:
        return np.full(len(theta_deg), math.nan)
    beyond = reading_deg - bias_deg - factor * theta_deg
    left = np.asarray(wrap_deg(beyond))
    turns = np.rint((beyond - left) / TURN_DEG)
    usual = turns == np.median(turns) if len(turns) else turns == 0.0
    if not usual.all() and _go_on(reading_deg, usual) and _strays(left, usual):
        left = beyond - TURN_DEG * np.median(turns)
    return np.asarray(left / factor, dtype=np.float64)


def rms(values: FloatArray) -> float:
    """√(Σv²/n), no degrees of freedom taken off."""
    return math.sqrt(float(values @ values) / len(values))
