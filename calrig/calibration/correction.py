"""Accepted effects applied: what each adds to a reading, and the elevation that a reading stands for.

The formulas of CONTRACT section 5, exact where the search linearises them. With s, c = sin θ, cos θ an
accelerometer that measures (0, s + δ, c + ε) turns its angle by atan2(δ·c − ε·s, 1 + δ·s + ε·c).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calrig.calibration.effect import Applied, ApplyError, Circumstances, Parameters
from calrig.calibration.effects import effect_of
from calrig.calibration.fit import MIN_SCALE, Line, fit_line
from calrig.estimation.angles import FloatArray, wrap_deg

ITERATIONS = 60
CONVERGED_DEG = 1e-10
DERIVATIVE_STEP_DEG = 1e-3


def numbers_of(parameters: Mapping[str, Any]) -> dict[str, float]:
    """The values of a diagnosis' parameters ({"value": …, "std": …}) or a calibration's (plain numbers)."""
    values = {
        name: given["value"] if isinstance(given, Mapping) else given for name, given in parameters.items()
    }
    return {name: float(value) for name, value in values.items() if value is not None}


def effect_on_reading_deg(
    name: str, parameters: Parameters, theta_deg: FloatArray, given: Circumstances | None = None
) -> FloatArray:
    """(n,) what an effect adds to the readings of n poses, degrees.

    Args:
        name: of the catalogue.
        parameters: values by the contract's names; one that is absent counts as 0, a reference must be there.
        theta_deg: (n,) elevations.
        given: what else the effect depends on.

    Raises:
        ApplyError: the effect has no formula, or a covariate or parameter that it needs is not there.
    """
    applied = Applied(name, parameters, theta_deg, given or Circumstances())
    return np.asarray(effect_of(name).on_reading_deg(applied), dtype=np.float64)


def effects_on_reading_deg(
    effects: Sequence[tuple[str, Parameters]], theta_deg: FloatArray, given: Circumstances | None = None
) -> FloatArray:
    """(n,) the sum of several effects, degrees."""
    total = np.zeros(len(theta_deg))
    for name, parameters in effects:
        total = total + effect_on_reading_deg(name, parameters, theta_deg, given)
    return total


def fit_line_with_effects(
    theta_deg: FloatArray,
    reading_deg: FloatArray,
    effects: Sequence[tuple[str, Parameters]],
    given: Circumstances | None = None,
) -> Line:
    """Bias and scale of what is left of the readings once the effects are taken out."""
    return fit_line(theta_deg, reading_deg - effects_on_reading_deg(effects, theta_deg, given))


def calibrated_elevation_deg(
    reading_deg: FloatArray,
    bias_deg: float,
    scale: float | None,
    effects: Sequence[tuple[str, Parameters]],
    given: Circumstances | None = None,
) -> FloatArray:
    """(n,) the θ with reading = bias + scale·θ + effects(θ), to 1e-9°, on the turn about 0.

    Newton's iteration from the θ without effects. Effects that depend on the elevation are read at θ itself.

    Raises:
        ApplyError: the scale is 0, or the effects are so large that one reading stands for many elevations.
    """
    factor = 1.0 if scale is None else scale
    if abs(factor) < MIN_SCALE:
        raise ApplyError(f"the scale is {factor:g}: the reading does not follow the elevation")
    aim = np.asarray(wrap_deg(reading_deg - bias_deg), dtype=np.float64)
    theta = aim / factor
    for _ in range(ITERATIONS):
        here = factor * theta + effects_on_reading_deg(effects, theta, given)
        ahead, behind = (
            effects_on_reading_deg(effects, theta + step, given)
            for step in (DERIVATIVE_STEP_DEG, -DERIVATIVE_STEP_DEG)
        )
        slope = factor + (ahead - behind) / (2.0 * DERIVATIVE_STEP_DEG)
        if (slope / factor <= 0.0).any():
            break
        step = np.asarray((aim - here) / slope, dtype=np.float64)
        theta = theta + step
        if not (np.abs(step) > CONVERGED_DEG).any():
            return theta
    raise ApplyError("the effects are too large for the scale: one reading would stand for many elevations")
