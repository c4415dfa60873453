"""Errors of poses: what a stage, bias and scale, and effects leave of what each reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calrig.calibration.line import Line, residuals_deg
from calrig.calibration.poses import HOST_TIME, OF_MOUNTS, Pose
from calrig.calibration.regression.effect import Circumstances
from calrig.calibration.regression.motion import (
    approach_of,
    filter_share,
    motion_of,
    moves_deg,
    stretches_deg,
    travel_deg,
)
from calrig.calibration.results.correction import AppliedEffect, effects_on_reading_deg, felt_elevation_deg
from calrig.estimation.angles import FloatArray, wrap_deg


def raw_error_deg(pose: Pose, sense: int = 1) -> float:
    """Reading less what the stage said, its map or no map, degrees, on the turn about 0.

    `sense` is −1 of a unit whose face was turned about the vertical: it reads the elevation's negative.
    """
    return float(wrap_deg(pose.reading_deg - sense * (pose.theta_deg - (pose.map_deg or 0.0))))


def residuals(poses: Sequence[Pose], bias_deg: float, scale: float | None) -> list[float | None]:
    """Return what calibration leaves of each pose, (reading − bias)/scale − θ in degrees, in their order.

    None throughout where the reading does not follow the stage (`MIN_SCALE`).
    """
    if not poses:
        return []
    theta, reading = angles_deg(poses)
    left_deg = residuals_deg(theta, reading, bias_deg, scale).tolist()
    return [left if math.isfinite(left) else None for left in left_deg]


def as_clamped(poses: Sequence[Pose], line: Line, effects: Sequence[AppliedEffect]) -> Line:
    """The line with the angle at which the unit is clamped in its bias, so that poses are right on average.

    Of a calibration that does not know the level (CONTRACT section 8): its elevations are relative to their
    mean. Errors as of `corrected_residuals_deg`.
    """
    for _ in range(4):  # effects act at the elevation that the sensor feels, which each step knows better
        left_deg = corrected_residuals_deg(poses, line, effects)
        line = replace(line, bias_deg=line.bias_deg + (line.scale or 1.0) * float(left_deg.mean()))
    return line


def corrected_residuals_deg(
    poses: Sequence[Pose], line: Line, effects: Sequence[AppliedEffect]
) -> FloatArray:
    """Return (n,) calibrated elevation of each pose, effects taken out, less the stage's.

    NaN where the scale is smaller than `MIN_SCALE`.

    Raises:
        ApplyError: the poses lack what an effect is a function of.
    """
    theta, _ = angles_deg(poses)
    return residuals_deg(theta, without_effects_deg(poses, line, effects), line.bias_deg, line.scale)


def without_effects_deg(
    poses: Sequence[Pose], line: Line, effects: Sequence[AppliedEffect], given: Circumstances | None = None
) -> FloatArray:
    """Return (n,) readings with the effects taken out; `given` are their circumstances, where known."""
    theta, reading = angles_deg(poses)
    felt = felt_elevation_deg(theta, line.bias_deg, line.scale)
    return reading - effects_on_reading_deg(effects, theta, given or circumstances(poses), felt)


def circumstances(poses: Sequence[Pose]) -> Circumstances:
    """Return what effects are functions of, as far as it is known of every pose.

    Further columns of the poses are among them, unless calrig itself gives their names a meaning.
    """

    def column(values: list[float | None]) -> FloatArray | None:
        return None if None in values else np.array(values, dtype=np.float64)

    motion, approach, move_deg = motion_of(poses), approach_of(poses), moves_deg(poses)
    starts = np.arange(len(poses)) == 0
    known = {
        "approach": approach,
        "temperature_c": column([pose.temperature_c for pose in poses]),
        "time_s": column([pose.time_s for pose in poses]),
        "move_deg": np.where([pose.settled for pose in poses], move_deg, np.nan),
        "travel_deg": travel_deg(move_deg, approach, starts),
        "velocity_dps": motion.velocity_dps if motion else None,
        "kappa": filter_share(poses),
        "stretch_deg": stretches_deg(poses),
    }
    own = {name for pose in poses for name in pose.covariates} - {*known, *OF_MOUNTS, HOST_TIME}
    return Circumstances(
        motion, **known, **{name: column([p.covariates.get(name) for p in poses]) for name in own}
    )


def angles_deg(poses: Sequence[Pose]) -> tuple[FloatArray, FloatArray]:
    """Return (n,) elevations and (n,) readings."""
    theta = np.array([pose.theta_deg for pose in poses], dtype=np.float64)
    return theta, np.array([pose.reading_deg for pose in poses], dtype=np.float64)
