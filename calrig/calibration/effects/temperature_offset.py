"""Offsets of the accelerometer's two axes that move with temperature: each a tempco in mg/°C."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.effect import TEMPERATURE, Applied, Effect, Parameter, Parameters, Shape
from calrig.calibration.effect_terms import (
    DEG,
    MG,
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

LARGEST_MG_PER_C = 10.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: ±60 mg over 70 °C, 0.9 mg/°C;
ten times as much."""


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    found = warmer_c(r, at)
    if found is not None and turns(r):
        warmer, reference_c = found
        s, c = sin_cos(r)
        angle = np.stack([warmer * c, -warmer * s], 1) * DEG * MG
        norm = np.stack([warmer * s, warmer * c], 1) * MG
        at = {"reference_c": reference_c}
        yield from one_or_both(angle, norm, ("y_mg_per_c", "z_mg_per_c"), at)


def _on_reading_deg(p: Applied) -> FloatArray:
    y, z = (p.value(name) / 1e3 * p.warmer_c() for name in ("y_mg_per_c", "z_mg_per_c"))
    return p.turn_deg(y, z)


def _in_c(p: Parameters) -> str:
    y, z = (f"{c_literal(p.get(name, 0.0) / 1e3)} * {c_warmer(p)}" for name in ("y_mg_per_c", "z_mg_per_c"))
    return c_turn(f"{y} * c - {z} * s", f"{y} * s + {z} * c")


EFFECT = Effect(
    name="temperature_offset",
    title="Offset that follows temperature",
    origin="sensor",
    scope="unit",
    covariate=TEMPERATURE,
    parameters=(
        Parameter("y_mg_per_c", "Temperature coefficient of y", "mg/°C"),
        Parameter("z_mg_per_c", "Temperature coefficient of z", "mg/°C"),
        Parameter("reference_c", "Reference temperature", "°C"),
    ),
    formula="atan2(y·cos θ − z·sin θ, 1 + y·sin θ + z·cos θ), "
    "y = y_mg_per_c/1000·(T − reference_c), z = z_mg_per_c/1000·(T − reference_c)",
    forms=_forms,
    on_reading_deg=_on_reading_deg,
    in_c=_in_c,
    apart="|accelerometer| changes with temperature as y·sin θ + z·cos θ",
    remedy="wait until the unit is warm, or correct the offsets by its own thermometer",
    together_with=("accelerometer_offset",),
    possible=within(y_mg_per_c=LARGEST_MG_PER_C, z_mg_per_c=LARGEST_MG_PER_C),
)
