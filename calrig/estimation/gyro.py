"""What the gyro says of itself: its bias from the dwells, its scale from the moves."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray, robust_std
from calrig.estimation.autoregressive import MIN_SAMPLES, fit_autoregression

MIN_TURN_DEG = 1.0
"""Shorter moves say more about noise and backlash than about scale."""


MISSING_PERIODS = 2.5
"""A longer step between two samples has lost more than one of them: what was turned in it is not known."""
MOST_ERROR_DEG = 0.03
MOST_ERROR_SHARE = 0.005
"""The most that a move's integral may be off by for too few samples, whichever is more."""

BLOCKS, FEWEST_OF_A_BLOCK = 20, 4
"""That a dwell is cut into where outliers are looked for; of fewer samples none are."""
OUTLIER_STD = 5.0


@dataclass(frozen=True, slots=True)
class GyroBias:
    """Bias about x, y, z in degrees per second; None where the axis is not measured or not known so well."""

    bias_dps: tuple[float | None, float | None, float | None]
    bias_std_dps: tuple[float | None, float | None, float | None]


@dataclass(frozen=True, slots=True)
class GyroScale:
    """Stage rotation over integrated rate, with its standard error (None from a single move)."""

    scale: float
    scale_std: float | None


def dwell_bias(gyro_dps: FloatArray) -> GyroBias:
    """Return the mean rate of one dwell, in which nothing turns.

    Whatever turned the unit all the same, a slip or a knock, is an outlier among the means of the dwell's
    blocks and is left out: a slip of 0.05° within 2 s would be taken for a bias of 0.025°/s. The standard
    error allows for the samples' correlation: √(long-run variance/n).

    `gyro_dps` (n, 3) are rates about x, y, z; NaN for an axis that the board does not send.
    """
    still_dps = [_without_outliers(axis) for axis in gyro_dps.T]
    means = [float(np.mean(axis)) if len(axis) else math.nan for axis in still_dps]
    errors = [
        math.sqrt(float(fit_autoregression(axis).density(np.zeros(1))[0]) / len(axis))
        if len(axis) >= MIN_SAMPLES and np.isfinite(axis).all()
        else math.nan
        for axis in still_dps
    ]
    return GyroBias(_known(means), _known(errors))


def _without_outliers(rate_dps: FloatArray) -> FloatArray:
    """Return the samples but for those of blocks whose mean is an outlier, by noise and median deviation."""
    length = len(rate_dps) // BLOCKS
    if length < FEWEST_OF_A_BLOCK:
        return rate_dps
    blocks, rest = rate_dps[: length * BLOCKS].reshape(BLOCKS, length), rate_dps[length * BLOCKS :]
    means = blocks.mean(axis=1)
    by_noise = float(np.std(np.diff(rate_dps))) / math.sqrt(2.0 * length)
    outlying = np.abs(means - np.median(means)) > OUTLIER_STD * max(robust_std(means), by_noise)
    return np.concatenate([blocks[~outlying].ravel(), rest]) if outlying.any() else rate_dps


def run_bias(bias_dps: FloatArray) -> GyroBias:
    """Return the bias of a run: the mean of its dwells' means.

    Its standard error comes from the scatter between dwells, so that a bias that wanders in the run makes it
    larger; a single dwell tells none.

    `bias_dps` (k, 3) are the biases of its dwells; NaN where one is not known.
    """
    known = [axis[np.isfinite(axis)] for axis in bias_dps.T]
    means = [float(np.mean(axis)) if len(axis) else math.nan for axis in known]
    errors = [
        float(np.std(axis, ddof=1)) / math.sqrt(len(axis)) if len(axis) > 1 else math.nan for axis in known
    ]
    return GyroBias(_known(means), _known(errors))


def move_angle_deg(
    time_s: FloatArray, rate_dps: FloatArray, bias_dps: float, gap_s: float = math.inf
) -> float | None:
    """Return angle turned by the gyro's account: rate less bias, integrated by trapezoids (`gyro_move_deg`).

    Args:
        time_s: (n,) the board's clock from the last sample of the dwell before to the first of this one.
        rate_dps: (n,) rate about the stage's axis.
        bias_dps: mean of the biases of the two dwells: the integral of one drifting evenly between them.
        gap_s: the longest step between two samples over which the rate is still known.

    Returns:
        Degrees; None with fewer than two samples, a longer step, or a rate that is not finite.
    """
    if len(time_s) < 2 or np.diff(time_s).max() > gap_s or not np.isfinite(rate_dps).all():
        return None
    return float(np.trapezoid(rate_dps - bias_dps, time_s))


def moves_about_axes(
    time_s: FloatArray, gyro_dps: FloatArray, dwells_s: Sequence[tuple[float, float]], gap_s: float = math.inf
) -> list[FloatArray | None]:
    """What a run's samples say of the move into each of its poses about each axis (`gyro_move_x_deg`, …).

    Args:
        time_s: (n,) the board's clock over the whole run, increasing.
        gyro_dps: (n, 3).
        dwells_s: first and last time of each pose's dwell, in the order measured.
        gap_s: as `move_angle_deg`.

    Returns:
        Of each pose (3,) degrees, less the mean bias of the two dwells; None of the first, and where samples
        are missing.
    """
    moves: list[FloatArray | None] = [None] * min(len(dwells_s), 1)
    means = [gyro_dps[(time_s >= first) & (time_s <= last)].mean(axis=0) for first, last in dwells_s]
    for k, ((_, left_s), (came_s, _)) in enumerate(pairwise(dwells_s)):
        between = (time_s >= left_s) & (time_s <= came_s)
        bias = 0.5 * (means[k] + means[k + 1])
        angles = [
            move_angle_deg(time_s[between], gyro_dps[between, axis], float(bias[axis]), gap_s)
            for axis in range(3)
        ]
        moves.append(None if None in angles else np.array(angles, dtype=np.float64))
    return moves


def integration_error_deg(time_s: FloatArray, rate_dps: FloatArray) -> float:
    """How far trapezoids may be off for a rate that rises and falls in straight lines between its samples.

    A kink of slope Δ anywhere in a step h costs Δh²/8 at most, and shows in the second differences of the
    samples beside it, whose squares sum to (Δh)²/2 at least. Of a move's four kinks two are convex and two
    concave, with errors of opposite signs, so that √(2·Σ(second difference·h)²)/8 covers all four.

    Args:
        time_s: (n,) strictly increasing.
        rate_dps: (n,) rate; its noise σ adds about 0.4·σ·√(duration·step).
    """
    step_s = np.diff(time_s)
    longer_s = np.maximum(step_s[1:], step_s[:-1])
    bend_dps = np.diff(np.diff(rate_dps) / step_s) * longer_s
    return float(np.sqrt(2.0 * np.sum((bend_dps * longer_s) ** 2))) / 8.0


def felt_move_deg(
    time_s: FloatArray, rate_dps: FloatArray, bias_dps: float, period_s: float, lasts_s: float = math.inf
) -> float | None:
    """`move_angle_deg` where the samples can carry it.

    `lasts_s` is the time that the stage needs for the move, 0 where nothing is to move; one of less than two
    periods `period_s` may pass unseen. The others are as there.

    Returns:
        Degrees; None also where samples are missing (`MISSING_PERIODS`), where the move is over within two
        of them, and where there are too few for its profile (`integration_error_deg` beyond half a percent
        of the angle and 0.03°).
    """
    angle_deg = move_angle_deg(time_s, rate_dps, bias_dps, MISSING_PERIODS * period_s)
    if angle_deg is None or 0.0 < lasts_s < 2.0 * period_s:
        return None
    allowed_deg = max(MOST_ERROR_DEG, MOST_ERROR_SHARE * abs(angle_deg))
    return angle_deg if integration_error_deg(time_s, rate_dps) <= allowed_deg else None


def gyro_scale(turned_deg: npt.ArrayLike, gyro_move_deg: npt.ArrayLike) -> GyroScale | None:
    """Return the factor by which integrated rate must be multiplied to give what the stage turned.

    Least squares through the origin over all moves of `MIN_TURN_DEG` and more, its standard error from their
    scatter (Draper & Smith, Applied Regression Analysis, 1998, chapter 1).

    Args:
        turned_deg: (m,) rotation of each move by the stage, signed; NaN where not known.
        gyro_move_deg: (m,) integrated rate of the same moves; NaN where not known.

    Returns:
        None where nothing turned, or the gyro felt nothing of it.
    """
    turned = np.asarray(turned_deg, dtype=np.float64)
    felt = np.asarray(gyro_move_deg, dtype=np.float64)
    used = (np.abs(turned) >= MIN_TURN_DEG) & np.isfinite(felt)
    turned, felt = turned[used], felt[used]
    power = float(felt @ felt)
    if power == 0.0:
        return None
    scale = float(turned @ felt) / power
    if len(turned) == 1:
        return GyroScale(scale, None)
    residual = turned - scale * felt
    variance = float(residual @ residual) / (len(turned) - 1)
    return GyroScale(scale, math.sqrt(variance / power))


def _known(values: list[float]) -> tuple[float | None, float | None, float | None]:
    x, y, z = (value if math.isfinite(value) else None for value in values)
    return x, y, z
