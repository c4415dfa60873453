"""Gain and skew of the accelerometer's axes that move with temperature."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from calrig.calibration.effect import TEMPERATURE, Applied, Effect, Parameter, Parameters, Shape
from calrig.calibration.effect_terms import (
    DEG,
    c_literal,
    c_turn,
    c_warmer,
    one_or_both,
    sin_cos,
    turns,
    warmer_c,
    within,
)
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

NAMES = ("gain_pct_per_c", "skew_deg_per_c")

LARGEST_PCT_PER_C, LARGEST_SKEW_DEG_PER_C = 1.0, 0.1
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: ±0.02 %/°C; fifty times as much."""


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    found = warmer_c(r, at)
    if found is not None and turns(r):
        warmer, reference_c = found
        s, c = sin_cos(r)
        angle = np.stack([s * c * DEG / 100.0, c * c], 1) * warmer[:, None]
        norm = np.stack([s * s / 100.0, s * c / DEG], 1) * warmer[:, None]
        yield from one_or_both(angle, norm, NAMES, {"reference_c": reference_c})


def _on_reading_deg(p: Applied) -> FloatArray:
    s, c = p.sin_cos()
    gain = p.value(NAMES[0]) / 100.0 * p.warmer_c()
    skew = np.radians(p.value(NAMES[1])) * p.warmer_c()
    return p.turn_deg(gain * s + skew * c, 0.0)


def _in_c(p: Parameters) -> str:
    gain, skew = p.get(NAMES[0], 0.0) / 100.0, math.radians(p.get(NAMES[1], 0.0))
    error = f"{c_warmer(p)} * ({c_literal(gain)} * s + {c_literal(skew)} * c)"
    return c_turn(f"{error} * c", f"{error} * s")


EFFECT = Effect(
    name="temperature_gain",
    title="Gain of the accelerometer that follows temperature",
    origin="sensor",
    scope="unit",
    covariate=TEMPERATURE,
    parameters=(
        Parameter(NAMES[0], "Temperature coefficient of the gain", "%/°C"),
        Parameter(NAMES[1], "Temperature coefficient of the skew", "°/°C"),
        Parameter("reference_c", "Reference temperature", "°C"),
    ),
    formula="atan2(δ·cos θ, 1 + δ·sin θ), "
    "δ = (T − reference_c)·(gain_pct_per_c/100·sin θ + skew_deg_per_c·π/180·cos θ)",
    forms=_forms,
    on_reading_deg=_on_reading_deg,
    in_c=_in_c,
    apart="|accelerometer| changes with temperature as gain·sin² θ and skew·sin θ·cos θ",
    remedy="wait until the unit is warm, or correct the gains by its own thermometer",
    together_with=("axis_mismatch",),
    possible=within(gain_pct_per_c=LARGEST_PCT_PER_C, skew_deg_per_c=LARGEST_SKEW_DEG_PER_C),
)
