"""Accepted effects applied: what each adds to a reading, and the elevation that a reading stands for.

The formulas of CONTRACT section 5, exact where the search linearises them. With s, c = sin θ, cos θ an
accelerometer that measures (0, s + δ, c + ε) turns its angle by atan2(δ·c − ε·s, 1 + δ·s + ε·c).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calrig.calibration.fit import MIN_SCALE, Line, fit_line
from calrig.calibration.responses import filter_share
from calrig.estimation.angles import FloatArray, wrap_deg

ITERATIONS = 60
CONVERGED_DEG = 1e-10
DERIVATIVE_STEP_DEG = 1e-3
Parameters = Mapping[str, float]


class ApplyError(ValueError):
    """An effect cannot be applied: unknown, without a parameter or a covariate it needs, or not to invert."""


@dataclass(frozen=True, slots=True, eq=False)
class Circumstances:
    """What effects are functions of, beside the elevation: (n,) each, None where not known.

    Attributes:
        approach: +1, −1; 0 where unknown, to which backlash adds nothing.
        move_deg: θ less the pose before's; NaN for a run's first pose, to which a move adds nothing.
        time_s: without it a slip has happened: the unit stands as it stood last.
    """

    approach: FloatArray | None = None
    temperature_c: FloatArray | None = None
    time_s: FloatArray | None = None
    move_deg: FloatArray | None = None
    velocity_dps: FloatArray | None = None
    settle_s: FloatArray | None = None


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
        name: of CONTRACT section 5, or `temperature_curvature` (deg_per_c2, reference_c). Where a
            `temperature_bias` has `of_axis_y` 1, its degrees are those of a y axis that lies level.
        parameters: values by the contract's names; one that is absent counts as 0, a reference must be there.
        theta_deg: (n,) elevations.
        given: what else the effect depends on.

    Raises:
        ApplyError: the effect has no formula, or a covariate or parameter that it needs is not there.
    """
    formula = _FORMULAS.get(name)
    if formula is None:
        raise ApplyError(f"the effect {name!r} has no formula of its own that could be applied")
    return np.asarray(formula(_Here(name, parameters, theta_deg, given or Circumstances())), dtype=np.float64)


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


@dataclass(frozen=True, slots=True, eq=False)
class _Here:
    """An effect at some elevations; what it needs and has not is missed by name."""

    effect: str
    parameters: Parameters
    theta: FloatArray
    given: Circumstances

    def value(self, name: str, default: float | None = 0.0) -> float:
        found = self.parameters.get(name, default)
        if found is None:
            raise ApplyError(f"the effect {self.effect} needs its parameter {name}")
        return found

    def column(self, name: str) -> FloatArray:
        values: FloatArray | None = getattr(self.given, name)
        if values is None:
            raise ApplyError(f"the effect {self.effect} needs {name} of every pose")
        return values

    def sin_cos(self) -> tuple[FloatArray, FloatArray]:
        angle = np.radians(self.theta)
        return np.sin(angle), np.cos(angle)

    def turn_deg(self, error_y: FloatArray | float, error_z: float) -> FloatArray:
        """Angle by which errors of a_y and a_z (g) turn the measured vector."""
        s, c = self.sin_cos()
        across, along = error_y * c - error_z * s, 1.0 + error_y * s + error_z * c
        return np.asarray(np.degrees(np.arctan2(across, along)), dtype=np.float64)

    def warmer_c(self) -> FloatArray:
        return self.column("temperature_c") - self.value("reference_c", None)

    def moved_deg(self) -> FloatArray:
        return np.asarray(np.nan_to_num(self.column("move_deg"), nan=0.0), dtype=np.float64)


Formula = Callable[[_Here], FloatArray]


def _wave(p: _Here, turns: FloatArray) -> FloatArray:
    phase = 2.0 * np.pi * turns + np.radians(p.value("phase_deg"))
    return np.asarray(p.value("amplitude_deg") * np.sin(phase), dtype=np.float64)


def _axis_mismatch(p: _Here) -> FloatArray:
    s, c = p.sin_cos()
    gain = 1.0 + p.value("gain_pct") / 100.0
    return p.turn_deg(gain * (s + c * np.sin(np.radians(p.value("skew_deg")))) - s, 0.0)


def _temperature_bias(p: _Here) -> FloatArray:
    turn_deg = p.value("deg_per_c") * p.warmer_c()
    return p.turn_deg(np.radians(turn_deg), 0.0) if p.value("of_axis_y") else turn_deg


def _mount_slip(p: _Here) -> FloatArray:
    step = np.full(len(p.theta), p.value("step_deg"))
    if p.given.time_s is None:
        return step
    return np.asarray(step * (p.given.time_s > p.value("at_s", None)), dtype=np.float64)


def _gyro_scale(p: _Here) -> FloatArray:
    return filter_share(p.given.settle_s, len(p.theta)) * p.value("gain_pct") / 100.0 * p.moved_deg()


_FORMULAS: dict[str, Formula] = {
    "backlash": lambda p: p.value("backlash_deg") / 2.0 * p.column("approach"),
    "stage_eccentricity": lambda p: _wave(p, p.theta / 360.0),
    "stage_periodic": lambda p: _wave(p, p.theta / p.value("period_deg", None)),
    "accelerometer_offset": lambda p: p.turn_deg(p.value("y_mg") / 1e3, p.value("z_mg") / 1e3),
    "axis_mismatch": _axis_mismatch,
    "nonlinearity": lambda p: p.value("deg_per_deg2") * p.theta**2 + p.value("deg_per_deg3") * p.theta**3,
    "temperature_bias": _temperature_bias,
    "temperature_curvature": lambda p: p.value("deg_per_c2") * p.warmer_c() ** 2,
    "temperature_scale": lambda p: p.value("per_c") * p.warmer_c() * p.theta,
    "time_drift": lambda p: p.value("deg_per_s") * p.column("time_s"),
    "mount_slip": _mount_slip,
    "settling": lambda p: -p.value("fraction") * p.moved_deg(),
    "gyro_scale": _gyro_scale,
    "latency": lambda p: -p.value("delay_s") * p.column("velocity_dps"),
}
"""What each effect adds to the reading, degrees: CONTRACT section 5."""
