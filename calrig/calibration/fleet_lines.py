"""Bias and scale of many runs at once, as `calrig.calibration.fit` has them of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calrig.calibration.fit import MIN_SCALE
from calrig.calibration.packed_poses import Intp, PackedPoses
from calrig.estimation.angles import FloatArray, wrap_deg


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """The lines through R runs of n poses each.

    Attributes:
        theta_deg: (R, n) elevations.
        given: the other columns of the poses by name, (R, n) each; `covariates` are those without physics.
        left_deg: (R, n) readings less the line.
        bias_deg, scale: (R,); NaN where all poses were commanded to one elevation, which tells no scale.
        rms_deg: (R,) of what is left.
    """

    theta_deg: FloatArray
    given: dict[str, FloatArray]
    covariates: Sequence[str]
    left_deg: FloatArray
    bias_deg: FloatArray
    scale: FloatArray
    rms_deg: FloatArray

    @property
    def residual_deg(self) -> FloatArray:
        """(R, n) what is left in degrees of elevation; NaN where the reading does not follow the stage."""
        factor = np.where(np.isnan(self.scale), 1.0, self.scale)
        factor = np.where(np.abs(factor) < MIN_SCALE, np.nan, factor)
        return np.asarray(self.left_deg / factor[:, None])

    @property
    def is_rounding(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """(R,) whether nothing is left but what arithmetic leaves."""
        largest = np.maximum(360.0, np.abs(self.theta_deg).max(axis=1))
        arithmetic = self.theta_deg.shape[1] * np.finfo(np.float64).eps * largest
        return np.asarray(self.rms_deg <= arithmetic)


def lines_of(poses: PackedPoses, theta_deg: FloatArray, rows: Intp) -> Lines:
    """The lines of runs by least squares.

    Args:
        poses: packed.
        theta_deg: (N,) their elevations.
        rows: (R, n) the poses of each run.
    """
    theta = theta_deg[rows]
    given = {name: column[rows] for name, column in poses.columns.items()}
    error = given["reading_deg"] - theta
    error = error[:, :1] + wrap_deg(error - error[:, :1])  # all on the turn of the first
    centre, level = theta.mean(axis=1), error.mean(axis=1)
    off = theta - centre[:, None]
    power = (off * off).sum(axis=1)
    turns = (np.ptp(given["target_deg"], axis=1) > 0.0) & (power > 0.0)
    slope = np.divide((off * error).sum(axis=1), power, out=np.zeros(len(power)), where=turns)
    left = error - level[:, None] - slope[:, None] * off
    return Lines(
        theta_deg=theta,
        given=given,
        covariates=poses.covariates,
        left_deg=left,
        bias_deg=np.asarray(wrap_deg(level - slope * centre)),
        scale=np.where(turns, 1.0 + slope, np.nan),
        rms_deg=np.sqrt((left * left).mean(axis=1)),
    )
