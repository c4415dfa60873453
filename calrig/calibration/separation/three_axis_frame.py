"""A whole accelerometer as `true = matrix·(raw − bias)`, in its sensor's frame or in that of its faces.

In the sensor's own frame the matrix is upper triangular: nine numbers with the offsets, and gravity alone
tells them. The faces that the unit was clamped by have a frame of their own: that in which the tilts of its
mounts are least (Kabsch, Acta Crystallographica A32, 1976). Twelve numbers then, of which the three of the
turn are as good as the seats repeat; how well they do, the tilts left over tell.

A whole unit as its elevation has it: what its y and z do while it turns about the axis it was clamped by.

That axis is where the stage's lay in the mounts with x along it; without such a mount it is the x of the
faces. In the plane across it a whole unit is one of `unit_model`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calrig.calibration.separation.level import RANGE_DEG, STEP_DEG, ElevationUncertainty
from calrig.calibration.separation.pose_table import Intp
from calrig.calibration.separation.three_axis_fit import UNTOLD, ThreeAxisFit
from calrig.calibration.separation.three_axis_model import (
    BIAS,
    CUBIC,
    GAIN,
    LARGEST,
    PER_C,
    QUADRATIC,
    SKEW,
    response,
    skewed,
)
from calrig.calibration.separation.unit_model import NAMES, sensed
from calrig.estimation.angles import AXES, FloatArray, wrap_deg

Frame = Literal["sensor", "faces"]
STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Accelerometer:
    """true = matrix·(raw − bias), with the curvatures of raw taken off first where the model has them.

    Attributes:
        bias_g: (3,).
        matrix: (3, 3).
        covariance: (12, 12) of bias, then matrix row by row.
        curvature_g: (2, 3) of the square and the cube of what acts along each axis, or None.
        frame: that of `true`.
        turn: (3, 3) from the sensor's frame to it.
        turn_std_rad: of that turn about each axis, from how the seats repeat; 0 in the sensor's own.
    """

    bias_g: FloatArray
    matrix: FloatArray
    covariance: FloatArray
    curvature_g: FloatArray | None
    frame: Frame
    turn: FloatArray
    turn_std_rad: float

    @property
    def stds(self) -> FloatArray:
        """(12,) standard errors."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def accelerometer(fit: ThreeAxisFit, unit: int, frame: Frame = "sensor") -> Accelerometer | None:
    """One unit's accelerometer; None where the poses do not tell it, or its faces' frame."""
    problem, at = fit.problem, fit.problem.unit_at(unit)
    own = slice(at.start, at.start + SKEW.stop)
    if untold(fit, unit) or (frame == "faces" and len(axes_of(fit, unit)) < len(AXES) - 1):
        return None

    def numbers(parameters: FloatArray) -> FloatArray:
        turn = faces_frame(fit, unit, parameters) if frame == "faces" else np.eye(3)
        matrix = turn @ np.linalg.inv(response(parameters[at]))
        return np.concatenate([parameters[at][BIAS], matrix.ravel()])

    found = numbers(fit.parameters)
    touched = np.r_[own, _tilts_of(fit, unit)]
    slopes = slopes_of(numbers, fit.parameters, touched)
    covariance = slopes @ fit.covariance[np.ix_(touched, touched)] @ slopes.T
    matrix, std = found[3:].reshape(3, 3), 0.0
    turn = np.eye(3)
    if frame == "faces":
        turn, std = faces_frame(fit, unit, fit.parameters), seats_std_rad(fit, unit)
        by_turn = np.zeros((12, 3))
        by_turn[3:] = np.stack([(about @ matrix).ravel() for about in _about_each()], axis=1)
        std *= np.sqrt(
            1.5 / len(_mounts_of(fit, unit))
        )  # each turn is seen by the mounts of the other two axes
        covariance = covariance + std**2 * by_turn @ by_turn.T
    curvature = None if problem.linear else fit.parameters[at][9 : CUBIC.stop].reshape(2, 3)
    return Accelerometer(found[:3], matrix, covariance, curvature, frame, turn, std)


def untold(fit: ThreeAxisFit, unit: int) -> list[str]:
    """Which of a unit's offsets, gains and skews the poses do not tell."""
    first = fit.problem.unit_at(unit).start
    return [
        fit.problem.title(first + k) for k in range(SKEW.stop) if fit.stds[first + k] > UNTOLD * LARGEST[k]
    ]


def axes_of(fit: ThreeAxisFit, unit: int) -> set[str]:
    """Which of a unit's axes lay along the stage's."""
    return {fit.problem.of.faces[mount][-1] for mount in _mounts_of(fit, unit)}


def faces_frame(fit: ThreeAxisFit, unit: int, parameters: FloatArray) -> FloatArray:
    """(3, 3) rotation from the sensor's frame to that of the faces."""
    seen, stated = _stage_axes(fit, unit, parameters)
    left, _, right = np.linalg.svd(stated.T @ seen)
    flip = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    return np.asarray(left @ flip @ right)


def seats_std_rad(fit: ThreeAxisFit, unit: int) -> float:
    """How far a face's seat is off about each axis: the tilts left in the faces' frame, 3 spent on it."""
    seen, stated = _stage_axes(fit, unit, fit.parameters)
    left = seen @ faces_frame(fit, unit, fit.parameters).T - stated
    freedom = max(2 * len(seen) - 3, 1)
    return float(np.sqrt((left**2).sum() / freedom))


def slopes_of(
    function: Callable[[FloatArray], FloatArray], parameters: FloatArray, touched: Intp
) -> FloatArray:
    """(k, m) derivatives of a function (k,) by those of the parameters (m,) that it depends on."""
    found = []
    for place in touched:
        step = np.zeros(len(parameters))
        step[int(place)] = STEP
        found.append((function(parameters + step) - function(parameters - step)) / (2.0 * STEP))
    return np.stack(found, axis=1)


def _stage_axes(fit: ThreeAxisFit, unit: int, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(mounts, 3) the stage's axis in the sensor's frame, and as the faces' names have it."""
    mounts, faces = _mounts_of(fit, unit), fit.problem.of.faces
    seen = np.stack([fit.problem.clamped(parameters, mount)[:, 0] for mount in mounts])
    signs = np.array([-1.0 if faces[mount].startswith("-") else 1.0 for mount in mounts])
    stated = np.stack([np.eye(3)[AXES.index(faces[mount][-1])] for mount in mounts])
    return seen, signs[:, None] * stated


def _mounts_of(fit: ThreeAxisFit, unit: int) -> list[int]:
    return [k for k, mount in enumerate(fit.problem.table.mounts) if mount.unit == unit]


def _tilts_of(fit: ThreeAxisFit, unit: int) -> Intp:
    return np.concatenate([np.r_[fit.problem.tilts_at(mount)] for mount in _mounts_of(fit, unit)])


def _about_each() -> list[FloatArray]:
    """(3, 3) of small turns about x, y and z."""
    found = np.zeros((3, 3, 3))
    for axis in range(3):
        found[axis, (axis + 2) % 3, (axis + 1) % 3] = 1.0
        found[axis, (axis + 1) % 3, (axis + 2) % 3] = -1.0
    return list(found)


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


def worth_of_whole(fit: ThreeAxisFit, unit: int, plane: InPlane) -> ElevationUncertainty:
    """What its calibrated elevation is worth, relative to its mean over the range."""
    low, high = _range_deg(fit, unit)
    grid = np.linspace(low, high, max(round((high - low) / STEP_DEG) + 1, 3))
    seen = sensed(plane.own, np.radians(grid))
    turn = seen.turned(seen.by_elevation[:, :, None])
    by = (-seen.turned(seen.by_parameters) / turn) @ plane.by_parameters
    by -= by.mean(axis=0)
    variance = np.einsum("gi,ij,gj->g", by, fit.covariance, by)
    return ElevationUncertainty(grid, np.degrees(np.sqrt(np.maximum(variance, 0.0))), by)


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
