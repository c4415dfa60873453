"""Errors of poses: what a stage, bias and scale, and effects leave of what each reads."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calrig.calibration.effects import effect_of
from calrig.calibration.line import Line, residuals_deg
from calrig.calibration.poses import HOST_TIME, OF_MOUNTS, Pose
from calrig.calibration.regression.effect import ELEVATION, LAST_MOVE, OF_SENSOR, Applied, Circumstances
from calrig.calibration.regression.motion import (
    approach_of,
    filter_share,
    motion_of,
    moves_deg,
    stretches_deg,
    travel_deg,
    with_approach,
)
from calrig.calibration.results.correction import (
    AppliedEffect,
    effects_on_reading_deg,
    elevation_errors_deg,
    error_on_vector_g,
    felt_elevation_deg,
    fit_line_with_effects,
)
from calrig.estimation.angles import FloatArray, wrap_deg

STEEPEST_DEG = 80.0
"""Beyond it the angle says next to nothing of an error of y; as in the effect `nonlinearity`."""


def raw_error_deg(pose: Pose, sense: int = 1, bias_deg: float = 0.0) -> float:
    """Reading less what the stage said, its map or no map, degrees, on the turn about the bias where known.

    `sense` is −1 of a unit whose face was turned about the vertical: it reads the elevation's negative.
    """
    off_deg = pose.reading_deg - sense * (pose.theta_deg - (pose.map_deg or 0.0))
    return float(bias_deg + wrap_deg(off_deg - bias_deg))


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
        left_deg = readings_left_deg(poses, line, effects)
        line = replace(line, bias_deg=line.bias_deg + float(left_deg.mean()))
    return line


def corrected_residuals_deg(
    poses: Sequence[Pose], line: Line, effects: Sequence[AppliedEffect]
) -> FloatArray:
    """Return (n,) calibrated elevation of each pose, effects taken out, less the stage's.

    NaN where the scale is smaller than `MIN_SCALE`, and where a curve of the unit turns round, so that one
    reading stands for many elevations.

    Raises:
        ApplyError: the poses lack what an effect is a function of.
    """
    theta, _ = angles_deg(poses)
    given = circumstances(poses)
    left_deg = readings_left_deg(poses, line, effects, given)
    return elevation_errors_deg(theta, left_deg, line, effects, given)


def readings_left_deg(
    poses: Sequence[Pose], line: Line, effects: Sequence[AppliedEffect], given: Circumstances | None = None
) -> FloatArray:
    """Return (n,) what line and effects leave of each reading, in degrees of the reading.

    `given` are their circumstances, where known; NaN where the scale is smaller than `MIN_SCALE`.

    Raises:
        ApplyError: the poses lack what an effect is a function of.
    """
    theta, _ = angles_deg(poses)
    without = without_effects_deg(poses, line, effects, given)
    return residuals_deg(theta, without, line.bias_deg, line.scale) * (line.scale or 1.0)


def without_effects_deg(
    poses: Sequence[Pose], line: Line, effects: Sequence[AppliedEffect], given: Circumstances | None = None
) -> FloatArray:
    """Return (n,) readings with the effects taken out; `given` are their circumstances, where known."""
    theta, reading = angles_deg(poses)
    felt = felt_elevation_deg(theta, line.bias_deg, line.scale)
    return reading - effects_on_reading_deg(effects, theta, given or circumstances(poses), felt)


def poses_without_effects(poses: Sequence[Pose], effects: Sequence[AppliedEffect]) -> list[Pose]:
    """Return the poses as a unit without these effects of its own would have given them.

    The effects are taken out of the reading and of the accelerometer's y and z, at the elevation of the
    sensor that bias and scale of these poses give. A curve of the elevation is an error of y: it changes the
    vector's length as well. What is the unit's because its reference is good turns the vector.

    Raises:
        ApplyError: the poses lack what an effect is a function of.
    """
    if not poses:
        return []
    theta, reading = angles_deg(poses)
    given = circumstances(poses)
    line = fit_line_with_effects(theta, reading, effects, given)
    felt_deg = felt_elevation_deg(theta, line.bias_deg, line.scale)
    left_deg = reading - effects_on_reading_deg(effects, theta, given, felt_deg)
    of_angle = [one for one in effects if effect_of(one[0]).covariate is not LAST_MOVE]
    of_axis_y = [
        one for one in of_angle if effect_of(one[0]).covariate is ELEVATION and OF_SENSOR not in one[1]
    ]
    cosine = np.cos(np.radians(np.clip(felt_deg, -STEEPEST_DEG, STEEPEST_DEG)))
    bent, turned = (
        np.radians(sum((_added_to_angle_deg(one, theta, given) for one in some), np.zeros(len(theta))))
        for some in (of_axis_y, [one for one in of_angle if one not in of_axis_y])
    )
    error_y, error_z = error_on_vector_g(effects, theta, given, felt_deg)
    return [
        replace(pose, reading_deg=float(left_deg[k]), **_vector_without(pose, error, float(turned[k])))
        for k, (pose, *error) in enumerate(zip(poses, error_y + bent / cosine, error_z, strict=True))
    ]


def _added_to_angle_deg(effect: AppliedEffect, theta_deg: FloatArray, given: Circumstances) -> FloatArray:
    """Return (n,) what an effect adds to the angle itself; 0 where it acts on the axes."""
    name, parameters = effect
    on_reading_deg = effect_of(name).on_reading_deg
    if on_reading_deg is None:
        return np.zeros(len(theta_deg))
    return on_reading_deg(Applied(name, parameters, theta_deg, given))


def _vector_without(pose: Pose, error_g: Sequence[float], turned_rad: float) -> dict[str, Any]:
    """The accelerometer's y and z less an error and turned back; nothing where they are not known."""
    if pose.accel_y_g is None or pose.accel_z_g is None:
        return {}
    y_g, z_g = pose.accel_y_g - float(error_g[0]), pose.accel_z_g - float(error_g[1])
    s, c = math.sin(turned_rad), math.cos(turned_rad)
    return {"accel_y_g": y_g * c - z_g * s, "accel_z_g": z_g * c + y_g * s}


def circumstances(poses: Sequence[Pose]) -> Circumstances:
    """Return what effects are functions of, as far as it is known of every pose.

    Further columns of the poses are among them, unless calrig itself gives their names a meaning. Where no
    column tells the approach, the order of the poses does, as in their diagnosis.
    """
    (poses,), _ = with_approach([poses])

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


def nominal_deg(poses: Sequence[Pose]) -> FloatArray:
    """Return (n,) elevations that the poses were commanded to, by the angle at which the unit was clamped."""
    return np.array([pose.target_deg + wrap_deg(pose.mount_deg) for pose in poses], dtype=np.float64)


def angles_deg(poses: Sequence[Pose]) -> tuple[FloatArray, FloatArray]:
    """Return (n,) elevations and (n,) readings."""
    theta = np.array([pose.theta_deg for pose in poses], dtype=np.float64)
    return theta, np.array([pose.reading_deg for pose in poses], dtype=np.float64)
