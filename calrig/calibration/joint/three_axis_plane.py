"""A whole unit as its elevation has it: what its y and z do while it turns about the axis it was clamped by.

That axis is where the stage's lay in the mounts with x along it; without such a mount it is the x of the
faces. In the plane across it a whole unit is one of `unit_model`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.elevation import RANGE_DEG, STEP_DEG, Worth
from calrig.calibration.joint.three_axis_fit import ThreeAxisFit
from calrig.calibration.joint.three_axis_frame import axes_of, faces_frame, slopes_of
from calrig.calibration.joint.three_axis_model import BIAS, CUBIC, GAIN, PER_C, QUADRATIC, skewed
from calrig.calibration.joint.unit_model import NAMES, sensed
from calrig.estimation.angles import FloatArray, wrap_deg


@dataclass(frozen=True, slots=True, eq=False)
class InPlane:
    """A unit's parameters as `unit_model` has them, and by those of the joint fit.

    Attributes:
        own: (11,).
        by_parameters: (11, p).
        covariance: (11, 11).
    """

    own: FloatArray
    by_parameters: FloatArray
    covariance: FloatArray


def in_plane(fit: ThreeAxisFit, unit: int) -> InPlane:
    """One unit about its x axis."""
    problem = fit.problem
    mounts = [k for k, mount in enumerate(problem.table.mounts) if mount.unit == unit]
    touched = np.concatenate([np.r_[problem.unit_at(unit)], *(np.r_[problem.tilts_at(k)] for k in mounts)])

    def numbers(parameters: FloatArray) -> FloatArray:
        return _about(parameters[problem.unit_at(unit)], _axis(fit, unit, parameters))

    by = np.zeros((len(NAMES), problem.size))
    by[:, touched] = slopes_of(numbers, fit.parameters, touched)
    return InPlane(numbers(fit.parameters), by, by @ fit.covariance @ by.T)


def worth_of_whole(fit: ThreeAxisFit, unit: int, plane: InPlane) -> Worth:
    """What its calibrated elevation is worth, relative to its mean over the range."""
    low, high = _range_deg(fit, unit)
    grid = np.linspace(low, high, max(round((high - low) / STEP_DEG) + 1, 3))
    seen = sensed(plane.own, np.radians(grid))
    turn = seen.turned(seen.by_elevation[:, :, None])
    by = (-seen.turned(seen.by_parameters) / turn) @ plane.by_parameters
    by -= by.mean(axis=0)
    variance = np.einsum("gi,ij,gj->g", by, fit.covariance, by)
    return Worth(grid, np.degrees(np.sqrt(np.maximum(variance, 0.0))), by)


def _range_deg(fit: ThreeAxisFit, unit: int) -> tuple[float, float]:
    """±60°, or what of it the unit was taken to about its x axis; all of it without a mount of x."""
    table = fit.problem.table
    about_x = np.array([face == "x" for face in fit.problem.of.faces])[table.mount]
    taken = about_x & (table.unit == unit) & fit.kept
    if not taken.any():
        return RANGE_DEG
    within = np.clip(wrap_deg(np.degrees(fit.problem.turns(fit.parameters)[taken])), *RANGE_DEG)
    return float(np.floor(within.min())), float(np.ceil(within.max()))


def _axis(fit: ThreeAxisFit, unit: int, parameters: FloatArray) -> FloatArray:
    """(3,) about which the unit's elevation is, in the sensor's frame."""
    problem, axis = fit.problem, np.zeros(3)
    for mount, face in enumerate(problem.of.faces):
        if face[-1] == "x" and problem.table.mounts[mount].unit == unit:
            axis += (-1.0 if face.startswith("-") else 1.0) * problem.clamped(parameters, mount)[:, 0]
    if not axis.any():
        axis = faces_frame(fit, unit, parameters)[0] if len(axes_of(fit, unit)) > 1 else np.eye(3)[0]
    return np.asarray(axis / np.linalg.norm(axis))


def _about(own: FloatArray, axis: FloatArray) -> FloatArray:
    """(11,) of a whole unit that turns about an axis, its elevation 0 where its z feels most."""
    up = np.eye(3)[2] - axis[2] * axis
    up /= np.linalg.norm(up)
    level = np.cross(up, axis)
    along_y, along_z = skewed(own)[1], skewed(own)[2]
    by_level, by_up, size_z = along_y @ level, along_y @ up, along_z @ up
    common = (1.0 + own[GAIN][2]) * size_z - 1.0
    gain = (1.0 + own[GAIN][1]) * by_level / (1.0 + common) - 1.0
    quadratic, cubic = own[QUADRATIC], own[CUBIC]
    return np.array(
        [
            common,
            gain,
            np.arcsin(by_up / by_level),
            own[BIAS][1],
            own[BIAS][2],
            quadratic[1] * by_level**2,
            cubic[1] * by_level**3,
            quadratic[2] * size_z**2,
            cubic[2] * size_z**3,
            own[PER_C][1],
            own[PER_C][2],
        ]
    )
