"""A y axis too long by its gain, and not square to z: gain/2·sin 2θ and skew·cos² θ."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from calrig.calibration.effect import ELEVATION, Applied, Effect, Parameter, Parameters, Shape
from calrig.calibration.effect_terms import DEG, c_literal, c_turn, one_or_both, sin_cos, turns, within
from calrig.calibration.responses import Responses
from calrig.estimation.angles import FloatArray

LARGEST_GAIN_PCT, LARGEST_SKEW_DEG = 10.0, 5.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: ±3 % of gain an axis, ±2 % (1.1°) across axes;
other parts have up to ±10 % (ADXL345 data sheet: 230 to 282 LSB/g)."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if turns(r):
        s, c = sin_cos(r)
        angle = np.stack([s * c * DEG / 100.0, c * c], 1)
        norm = np.stack([s * s / 100.0, s * c / DEG], 1)
        yield from one_or_both(angle, norm, ("gain_pct", "skew_deg"))


def _on_reading_deg(p: Applied) -> FloatArray:
    s, c = p.sin_cos()
    gain = 1.0 + p.value("gain_pct") / 100.0
    return p.turn_deg(gain * (s + c * np.sin(np.radians(p.value("skew_deg")))) - s, 0.0)


def _in_c(p: Parameters) -> str:
    gain = p.get("gain_pct", 0.0) / 100.0
    skew = (1.0 + gain) * math.sin(math.radians(p.get("skew_deg", 0.0)))
    error = f"({c_literal(gain)} * s + {c_literal(skew)} * c)"
    return c_turn(f"{error} * c", f"{error} * s")


EFFECT = Effect(
    name="axis_mismatch",
    title="Mismatch of the accelerometer's axes",
    origin="sensor",
    scope="unit",
    covariate=ELEVATION,
    parameters=(Parameter("gain_pct", "Gain error", "%"), Parameter("skew_deg", "Skew", "°")),
    formula="atan2(δ·cos θ, 1 + δ·sin θ), δ = (1 + gain_pct/100)·(sin θ + cos θ·sin skew_deg) − sin θ",
    forms=_forms,
    on_reading_deg=_on_reading_deg,
    in_c=_in_c,
    apart="|accelerometer| changes as gain·sin² θ and skew·sin θ·cos θ",
    remedy="correct gain and skew of the two axes in the firmware",
    possible=within(gain_pct=LARGEST_GAIN_PCT, skew_deg=LARGEST_SKEW_DEG),
)
