"""What a calibrated elevation is worth: less its mean over a range, or whole where its level is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calrig.calibration.joint.least_squares import Fit
from calrig.calibration.joint.level import Level
from calrig.calibration.joint.unit_model import CURVATURES, NAMES, sensed
from calrig.estimation.angles import FloatArray, wrap_deg

RANGE_DEG = (-60.0, 60.0)
STEP_DEG = 5.0
STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Worth:
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


def worth(fit: Fit, unit: int, level: Level | None = None) -> Worth:
    """By the full covariance of the joint fit; without a level of the elevation less its mean."""
    grid = grid_deg(fit, unit)
    own = sensed(fit.parameters[fit.problem.unit_at(unit)], np.radians(grid))
    turn = own.turned(own.by_elevation[:, :, None])
    by_parameters = np.zeros((len(grid), fit.problem.size))
    by_parameters[:, fit.problem.unit_at(unit)] = -own.turned(own.by_parameters) / turn
    by_parameters -= by_parameters.mean(axis=0) if level is None else level.by_parameters
    common = 0.0 if level is None else level.own_variance
    variance = np.diag(fit.covariance_of(by_parameters)) + common
    return Worth(grid, np.degrees(np.sqrt(np.maximum(variance, 0.0))), by_parameters, common)


def range_deg(fit: Fit, unit: int) -> tuple[float, float]:
    """±60°, or what of it the unit was taken to."""
    taken = (fit.problem.table.unit == unit) & fit.kept
    at = wrap_deg(np.degrees(fit.problem.elevations(fit.parameters)[taken]))
    within = np.clip(at, *RANGE_DEG)
    return float(np.floor(within.min())), float(np.ceil(within.max()))


def grid_deg(fit: Fit, unit: int) -> FloatArray:
    """(m,) elevations from one end of the range to the other."""
    low, high = range_deg(fit, unit)
    return np.linspace(low, high, max(round((high - low) / STEP_DEG) + 1, 3))


def polynomial(fit: Fit, unit: int) -> tuple[FloatArray, FloatArray]:
    """Coefficients of θ² and θ³ in the error of angle that the nonlinearity makes, bias and scale free.

    Returns:
        (2,) deg/deg² and deg/deg³, and (2, 2) their covariance.
    """
    at = fit.problem.unit_at(unit)
    covariance = fit.covariance_at(np.arange(fit.problem.size)[at])
    return polynomial_of(fit.parameters[at], covariance, grid_deg(fit, unit))


def polynomial_of(
    parameters: FloatArray, covariance: FloatArray, grid: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The same of one unit's parameters (11,) and their covariance, over elevations (m,) in degrees."""
    powers = np.linalg.pinv(np.vander(grid / 90.0, 4, increasing=True))[2:] / 90.0 ** np.array([[2.0], [3.0]])
    straight = np.ones(len(NAMES))
    straight[list(CURVATURES)] = 0.0

    def coefficients(own: FloatArray) -> FloatArray:
        elevation = np.radians(grid)
        bent, plain = sensed(own, elevation).angle(), sensed(own * straight, elevation).angle()
        return np.asarray(powers @ wrap_deg(np.degrees(bent - plain)))

    slopes = np.stack(
        [
            (coefficients(parameters + step) - coefficients(parameters - step)) / (2.0 * STEP)
            for step in STEP * np.eye(len(parameters))
        ],
        axis=1,
    )
    return coefficients(parameters), slopes @ covariance @ slopes.T
