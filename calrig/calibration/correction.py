"""Accepted effects applied: what each adds to a reading, and the elevation that a reading stands for.

The formulas of CONTRACT section 5, exact where the search linearises them. What acts on the accelerometer's
axes acts on one vector, at the elevation of the sensor itself: `sensor_vector`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calrig.calibration.effect import Applied, ApplyError, Circumstances, Effect, Parameters
from calrig.calibration.effects import effect_of
from calrig.calibration.fit import MIN_SCALE, Line, fit_line
from calrig.calibration.sensor_vector import TURNS_THE_SENSOR, turned_vector
from calrig.estimation.angles import FloatArray, wrap_deg

AppliedEffect = tuple[str, Parameters]
"""An accepted effect: its name and the values of its parameters."""

ITERATIONS = 60
CONVERGED_DEG = 1e-10
DERIVATIVE_STEP_DEG = 1e-3


def numbers_of(parameters: Mapping[str, Any]) -> dict[str, float]:
    """The values of a diagnosis' parameters ({"value": …, "std": …}) or a calibration's (plain numbers)."""
    values = {
        name: given["value"] if isinstance(given, Mapping) else given for name, given in parameters.items()
    }
    return {name: float(value) for name, value in values.items() if value is not None}


def effects_on_reading_deg(
    effects: Sequence[AppliedEffect],
    theta_deg: FloatArray,
    given: Circumstances | None = None,
    felt_deg: FloatArray | None = None,
) -> FloatArray:
    """(n,) what several effects together add to the readings of n poses, degrees.

    Args:
        effects: names of the catalogue, each with values by the contract's names; a value that is absent
            counts as 0, a reference must be there.
        theta_deg: (n,) elevations.
        given: what else the effects depend on.
        felt_deg: (n,) elevations of the sensor itself, bias + scale·θ, at which its axes err; θ where not
            given.

    Raises:
        ApplyError: an effect has no formula, or a covariate or parameter that it needs is not there.
    """
    felt_deg = theta_deg if felt_deg is None else felt_deg
    total = np.zeros(len(theta_deg))
    on_axes: list[tuple[Effect, Parameters]] = []
    for name, parameters in effects:
        effect = effect_of(name)
        if effect.on_reading_deg is not None:
            added = effect.on_reading_deg(Applied(name, parameters, theta_deg, given or Circumstances()))
            total = total + added
            if effect.origin in TURNS_THE_SENSOR:
                felt_deg = felt_deg + added
        if effect.on_vector_g is not None:
            on_axes.append((effect, parameters))
    error_y, error_z = np.zeros(len(theta_deg)), np.zeros(len(theta_deg))
    for effect, parameters in on_axes:
        assert effect.on_vector_g is not None  # noqa: S101 (so they were chosen)
        applied = Applied(effect.name, parameters, theta_deg, given or Circumstances(), felt_deg)
        more_y, more_z = effect.on_vector_g(applied)
        error_y, error_z = error_y + more_y, error_z + more_z
    return np.asarray(total + turned_vector(felt_deg, (error_y, error_z))[0], dtype=np.float64)


def fit_line_with_effects(
    theta_deg: FloatArray,
    reading_deg: FloatArray,
    effects: Sequence[AppliedEffect],
    given: Circumstances | None = None,
) -> Line:
    """Bias and scale of what is left of the readings once the effects are taken out."""
    line = fit_line(theta_deg, reading_deg - effects_on_reading_deg(effects, theta_deg, given))
    for _ in range(ITERATIONS):  # where the sensor's axes lie follows from bias and scale themselves
        felt_deg = felt_elevation_deg(theta_deg, line.bias_deg, line.scale)
        line = fit_line(theta_deg, reading_deg - effects_on_reading_deg(effects, theta_deg, given, felt_deg))
        moved = felt_elevation_deg(theta_deg, line.bias_deg, line.scale) - felt_deg
        if not (np.abs(wrap_deg(moved)) > CONVERGED_DEG).any():
            break
    return line


def felt_elevation_deg(theta_deg: FloatArray, bias_deg: float, scale: float | None) -> FloatArray:
    """(n,) elevations of the sensor itself, whose axes its errors belong to."""
    return bias_deg + (1.0 if scale is None else scale) * theta_deg


def calibrated_elevation_deg(
    reading_deg: FloatArray,
    bias_deg: float,
    scale: float | None,
    effects: Sequence[AppliedEffect],
    given: Circumstances | None = None,
) -> FloatArray:
    """(n,) the θ with reading = bias + scale·θ + effects(θ), to 1e-9°, on the turn about 0.

    NaN where one reading stands for many elevations. Newton's iteration from the θ without effects; those
    that depend on the elevation are read at θ itself.

    Raises:
        ApplyError: the scale is 0.
    """
    factor = 1.0 if scale is None else scale
    if abs(factor) < MIN_SCALE:
        raise ApplyError(f"the scale is {factor:g}: the reading does not follow the elevation")
    aim = np.asarray(wrap_deg(reading_deg - bias_deg), dtype=np.float64)
    theta = aim / factor
    stands_for_many = np.zeros(len(aim), dtype=np.bool_)

    def added_deg(at_deg: FloatArray) -> FloatArray:
        felt_deg = felt_elevation_deg(at_deg, bias_deg, scale)
        return effects_on_reading_deg(effects, at_deg, given, felt_deg)

    for _ in range(ITERATIONS):
        here = factor * theta + added_deg(theta)
        ahead, behind = (added_deg(theta + step) for step in (DERIVATIVE_STEP_DEG, -DERIVATIVE_STEP_DEG))
        slope = factor + (ahead - behind) / (2.0 * DERIVATIVE_STEP_DEG)
        stands_for_many |= slope / factor <= 0.0
        step = np.where(stands_for_many, 0.0, (aim - here) / np.where(stands_for_many, 1.0, slope))
        theta = theta + step
        moving = np.abs(step) > CONVERGED_DEG
        if not moving.any():
            break
    return np.where(stands_for_many | moving, np.nan, theta)
