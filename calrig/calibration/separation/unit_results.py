"""Results of one unit: its accelerometer as a matrix, and its elevation about the axis it was clamped by.

A whole accelerometer is `true = matrix·(raw − bias)`, in its sensor's frame or in that of its faces. In the
sensor's own frame the matrix is upper triangular: nine numbers with the offsets, and gravity alone tells
them. The faces that the unit was clamped by have a frame of their own: that in which the tilts of its mounts
are least (Kabsch, Acta Crystallographica A32, 1976). Twelve numbers then, of which the three of the rotation
are as good as the seats repeat; how well they do, the tilts left over tell.

The elevation is about the stage's axis as it lay in the mounts with ±x along it; without such a mount it is
about the x of the faces. How well it is known comes from the full covariance of the joint fit: less its mean
over a range, or whole where the unit's level is known. For poses only thought of, that is the Cramér-Rao
bound (Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 3.9).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calrig.calibration.separation.accelerometer import (
    BIAS,
    CUBIC,
    LARGEST,
    PLANE_CURVATURES,
    PLANE_NAMES,
    SKEW,
    plane_parameters,
    plane_vector,
    response,
)
from calrig.calibration.separation.least_squares import IDENTIFIED, Fit, at_parameters
from calrig.calibration.separation.level import Level
from calrig.calibration.separation.pose_table import Mount
from calrig.calibration.separation.problem import Problem
from calrig.estimation.angles import AXES, FloatArray, Intp, wrap_deg
from calrig.model.solution import Frame

STEP = 1e-6
RANGE_DEG = (-60.0, 60.0)
STEP_DEG = 5.0


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


def accelerometer(fit: Fit, unit: int, frame: Frame = "sensor") -> Accelerometer | None:
    """Return a whole unit's accelerometer; None where the poses do not identify it, or its faces' frame."""
    problem, at = fit.problem, fit.problem.unit_at(unit)
    own = slice(at.start, at.start + SKEW.stop)
    if unidentified(fit, unit) or (frame == "faces" and len(axes_of(fit, unit)) < len(AXES) - 1):
        return None

    def numbers(parameters: FloatArray) -> FloatArray:
        turn = faces_frame(fit, unit, parameters) if frame == "faces" else np.eye(3)
        matrix = turn @ np.linalg.inv(response(parameters[at]))
        return np.concatenate([parameters[at][BIAS], matrix.ravel()])

    found = numbers(fit.parameters)
    touched = np.r_[own, _tilts_of(fit, unit)]
    slopes = slopes_of(numbers, fit.parameters, touched)
    covariance = slopes @ fit.covariance_at(touched) @ slopes.T
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


def unidentified(fit: Fit, unit: int) -> list[str]:
    """Which of a whole unit's offsets, gains and skews the poses do not identify."""
    first = fit.problem.unit_at(unit).start
    return [
        fit.problem.title(first + k)
        for k in range(SKEW.stop)
        if fit.stds[first + k] > IDENTIFIED * LARGEST[k]
    ]


def axes_of(fit: Fit, unit: int) -> set[str]:
    """Which of a unit's axes lay along the stage's."""
    return {fit.problem.table.mounts[mount].axis[-1] for mount in _mounts_of(fit, unit)}


def faces_frame(fit: Fit, unit: int, parameters: FloatArray) -> FloatArray:
    """(3, 3) rotation from the sensor's frame to that of the faces."""
    seen, stated = _stage_axes(fit, unit, parameters)
    left, _, right = np.linalg.svd(stated.T @ seen)
    flip = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    return np.asarray(left @ flip @ right)


def seats_std_rad(fit: Fit, unit: int) -> float:
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


def _stage_axes(fit: Fit, unit: int, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(mounts, 3) the stage's axis in the sensor's frame, and as the faces' names have it."""
    mounts, table = _mounts_of(fit, unit), fit.problem.table
    seen = np.stack([fit.problem.clamped(parameters, mount)[:, 0] for mount in mounts])
    return seen, np.stack([table.faces[mount][:, 0] for mount in mounts])


def _mounts_of(fit: Fit, unit: int) -> list[int]:
    return [k for k, mount in enumerate(fit.problem.table.mounts) if mount.unit == unit]


def _tilts_of(fit: Fit, unit: int) -> Intp:
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
    """A unit's parameters about its x axis, as `PLANE_NAMES`, and by those of the joint fit.

    Attributes:
        own: (13,).
        by_parameters: (13, p).
        covariance: (13, 13).
    """

    own: FloatArray
    by_parameters: FloatArray
    covariance: FloatArray


def in_plane(fit: Fit, unit: int) -> InPlane:
    """Return one unit about its x axis."""
    problem = fit.problem
    touched = np.concatenate([problem.touched_by(unit), _tilts_of(fit, unit)])

    def numbers(parameters: FloatArray) -> FloatArray:
        return plane_parameters(problem.accelerometer(parameters, unit), _axis(fit, unit, parameters))

    by = np.zeros((len(PLANE_NAMES), problem.size))
    by[:, touched] = slopes_of(numbers, fit.parameters, touched)
    return InPlane(numbers(fit.parameters), by, fit.covariance_of(by))


def _axis(fit: Fit, unit: int, parameters: FloatArray) -> FloatArray:
    """(3,) about which the unit's elevation is, in the sensor's frame."""
    axis = np.zeros(3)
    for k in _mounts_of(fit, unit):
        mount = fit.problem.table.mounts[k]
        if mount.axis[-1] == "x":
            axis += mount.sense * fit.problem.clamped(parameters, k)[:, 0]
    if not axis.any():
        axis = faces_frame(fit, unit, parameters)[0] if len(axes_of(fit, unit)) > 1 else np.eye(3)[0]
    return np.asarray(axis / np.linalg.norm(axis))


@dataclass(frozen=True, slots=True, eq=False)
class ElevationUncertainty:
    """Standard errors of a unit's calibrated elevation over a range.

    Attributes:
        elevation_deg, std_deg: (m,).
        by_parameters: (m, p) of all the model's parameters, rad of elevation.
        common_variance: of all elevations together, rad², beside what comes by the parameters.
    """

    elevation_deg: FloatArray
    std_deg: FloatArray
    by_parameters: FloatArray
    common_variance: float = 0.0

    @property
    def rms_deg(self) -> float:
        """Over the range."""
        return float(np.sqrt(np.mean(self.std_deg**2)))


def elevation_uncertainty(
    fit: Fit, unit: int, plane: InPlane, level: Level | None = None
) -> ElevationUncertainty:
    """By the full covariance of the joint fit; without a level of the elevation less its mean."""
    low, high = _range_deg(fit, unit)
    grid = np.linspace(low, high, max(round((high - low) / STEP_DEG) + 1, 3))
    sensed = plane_vector(plane.own, np.radians(grid))
    turn = sensed.turned(sensed.by_elevation[:, :, None])
    by_parameters = (-sensed.turned(sensed.by_parameters) / turn) @ plane.by_parameters
    by_parameters -= by_parameters.mean(axis=0) if level is None else level.by_parameters
    common = 0.0 if level is None else level.own_variance
    variance = np.diag(fit.covariance_of(by_parameters)) + common
    return ElevationUncertainty(grid, np.degrees(np.sqrt(np.maximum(variance, 0.0))), by_parameters, common)


def _range_deg(fit: Fit, unit: int) -> tuple[float, float]:
    """±60°, or what of it the unit was taken to about its x axis; all of it without a mount of ±x."""
    table = fit.problem.table
    about_x = np.array([mount.axis[-1] == "x" for mount in table.mounts])[table.mount]
    taken = about_x & (table.unit == unit) & fit.kept
    if not taken.any():
        return RANGE_DEG
    elevation = (table.sense * fit.problem.turns(fit.parameters))[taken]
    within = np.clip(wrap_deg(np.degrees(elevation)), *RANGE_DEG)
    return float(np.floor(within.min())), float(np.ceil(within.max()))


def polynomial(plane: InPlane, grid_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of θ² and θ³ in the error of angle that the nonlinearity makes, bias and scale free.

    Args:
        plane: the unit.
        grid_deg: (m,) elevations over which the polynomial is fitted.

    Returns:
        (2,) deg/deg² and deg/deg³, and (2, 2) their covariance.
    """
    powers = np.linalg.pinv(np.vander(grid_deg / 90.0, 4, increasing=True))[2:]
    powers = powers / 90.0 ** np.array([[2.0], [3.0]])
    elevation, straight = np.radians(grid_deg), np.ones(len(PLANE_NAMES))
    straight[list(PLANE_CURVATURES)] = 0.0

    def coefficients(own: FloatArray) -> FloatArray:
        bent, plain = (plane_vector(some, elevation).angle() for some in (own, own * straight))
        return np.asarray(powers @ wrap_deg(np.degrees(bent - plain)))

    slopes = slopes_of(coefficients, plane.own, np.arange(len(plane.own)))
    return coefficients(plane.own), slopes @ plane.covariance @ slopes.T


def mounted_otherwise(
    fit: Fit, unit: int, rows: Intp, mounts_deg: Sequence[float], dial_deg: FloatArray | None = None
) -> ElevationUncertainty:
    """What would be known of the elevation of one unit in the plane, clamped at other angles, mounts alike.

    The fit says how large noise, map and the unit's errors are. To each mount are taken the dial angles of
    the poses `rows`, or `dial_deg` in place of these.
    """
    problem, n = fit.problem, len(mounts_deg)
    poses = problem.table.rows(np.tile(rows, n))
    table = replace(
        poses,
        dial_deg=poses.dial_deg if dial_deg is None else np.tile(dial_deg, n),
        units=(problem.table.units[unit],),
        mounts=tuple(Mount(f"{angle:g}°", 0, angle) for angle in mounts_deg),
        mount=np.repeat(np.arange(n), len(rows)),
        warmer_c=np.zeros(n * len(rows)),
        reference_c=np.full(1, np.nan),
    )
    thought_of = Problem(table, problem.orders, problem.linear, problem.correlation)
    parameters = np.zeros(thought_of.size)
    parameters[thought_of.unit_at(0)] = fit.parameters[problem.unit_at(unit)]
    parameters[thought_of.mounts_at] = np.radians(mounts_deg)
    parameters[thought_of.map_at] = fit.parameters[problem.map_at]
    bound = at_parameters(thought_of, parameters, fit.noise)
    return elevation_uncertainty(bound, 0, in_plane(bound, 0))
