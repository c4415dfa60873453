"""Gain and skew of the accelerometer's axes that move with temperature."""

import math

import numpy as np

from calrig.calibration.regression.effect import (
    TEMPERATURE,
    Applied,
    Effect,
    Parameter,
    Parameters,
    VectorError,
    VectorInC,
)
from calrig.calibration.regression.terms import (
    ON_VECTOR,
    c_literal,
    c_warmer,
    warm_vector_forms,
    within,
)

NAMES = ("gain_pct_per_c", "skew_deg_per_c")

LARGEST_PCT_PER_C, LARGEST_SKEW_DEG_PER_C = 1.0, 0.1
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: ±0.02 %/°C; fifty times as much."""


def _on_vector_g(p: Applied) -> VectorError:
    s, c = p.sin_cos()
    gain = p.value(NAMES[0]) / 100.0 * p.warmer_c()
    skew = np.radians(p.value(NAMES[1])) * p.warmer_c()
    return gain * s + skew * c, 0.0


def _in_c(p: Parameters) -> VectorInC:
    gain, skew = p.get(NAMES[0], 0.0) / 100.0, math.radians(p.get(NAMES[1], 0.0))
    return VectorInC(f"{c_warmer(p)} * ({c_literal(gain)} * s + {c_literal(skew)} * c)", "0.0f")


EFFECT = Effect(
    name="temperature_gain",
    title="Gain of the sensor's axes that follows temperature",
    origin="sensor",
    scope="unit",
    covariate=TEMPERATURE,
    parameters=(
        Parameter(NAMES[0], "Temperature coefficient of the gain", "%/°C"),
        Parameter(NAMES[1], "Temperature coefficient of the skew", "°/°C"),
        Parameter("reference_c", "Reference temperature", "°C"),
    ),
    formula=ON_VECTOR + "a_y + (T − reference_c)·(gain_pct_per_c/100·a_y + skew_deg_per_c·π/180·a_z)",
    forms=lambda r, at: warm_vector_forms(r, at, _on_vector_g, NAMES),
    on_vector_g=_on_vector_g,
    in_c=_in_c,
    apart="clamped at another angle, the unit takes it along",
    seen_by_gravity="|accelerometer| changes with temperature as gain·sin² θ and skew·sin θ·cos θ",
    remedy="wait until the unit is warm, or correct the gains by its own thermometer",
    together_with=("axis_mismatch",),
    possible=within(gain_pct_per_c=LARGEST_PCT_PER_C, skew_deg_per_c=LARGEST_SKEW_DEG_PER_C),
)
