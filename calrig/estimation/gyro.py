"""What the gyro says of itself: its bias from the dwells, its scale from the moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calrig.estimation.angles import FloatArray
from calrig.estimation.autoregressive import MIN_SAMPLES, fit_autoregression

MIN_TURN_DEG = 1.0
"""Shorter moves say more about noise and backlash than about scale."""


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
    """The mean rate of one dwell, in which nothing turns.

    The standard error allows for the samples' correlation: √(long-run variance/n).

    Args:
        gyro_dps: (n, 3) rates about x, y, z; NaN for an axis that the board does not send.
    """
    n = len(gyro_dps)
    means = [float(np.mean(axis)) if n else math.nan for axis in gyro_dps.T]
    errors = [
        math.sqrt(float(fit_autoregression(axis).density(np.zeros(1))[0]) / n)
        if n >= MIN_SAMPLES and np.isfinite(axis).all()
        else math.nan
        for axis in gyro_dps.T
    ]
    return GyroBias(_known(means), _known(errors))


def run_bias(dwells: list[GyroBias]) -> GyroBias:
    """The bias of a run: the mean of its dwells' means.

    Its standard error comes from the scatter between dwells, so that a bias that wanders in the run makes it
    larger; a single dwell passes its own on.
    """
    if len(dwells) == 1:
        return dwells[0]
    means, errors = [], []
    for axis in range(3):
        known = [bias for dwell in dwells if (bias := dwell.bias_dps[axis]) is not None]
        means.append(float(np.mean(known)) if known else math.nan)
        errors.append(float(np.std(known, ddof=1)) / math.sqrt(len(known)) if len(known) > 1 else math.nan)
    return GyroBias(_known(means), _known(errors))


def move_angle_deg(
    time_s: FloatArray, rate_dps: FloatArray, bias_dps: float, gap_s: float = math.inf
) -> float | None:
    """Angle turned by the gyro's account: rate less bias, integrated by trapezoids (`gyro_move_deg`).

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
    rate = rate_dps - bias_dps
    return float((rate[1:] + rate[:-1]) @ np.diff(time_s)) / 2.0


def gyro_scale(turned_deg: npt.ArrayLike, gyro_move_deg: npt.ArrayLike) -> GyroScale | None:
    """The factor by which integrated rate must be multiplied to give what the stage turned.

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
