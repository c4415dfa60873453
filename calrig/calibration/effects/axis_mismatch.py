"""A y axis too long by its gain, and not square to z: gain/2·sin 2θ and skew·cos² θ."""

import math

import numpy as np

from calrig.calibration.regression.effect import (
    ELEVATION,
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
    vector_forms,
    where_axes_show,
    within,
)

NAMES = ("gain_pct", "skew_deg")
LARGEST_GAIN_PCT, LARGEST_SKEW_DEG = 10.0, 5.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: ±3 % of gain an axis, ±2 % (1.1°) across axes;
other parts have up to ±10 % (ADXL345 data sheet: 230 to 282 LSB/g)."""


def _on_vector_g(p: Applied) -> VectorError:
    s, c = p.sin_cos()
    gain = 1.0 + p.value("gain_pct") / 100.0
    return gain * (s + c * np.sin(np.radians(p.value("skew_deg")))) - s, 0.0


def _in_c(p: Parameters) -> VectorInC:
    gain = p.get("gain_pct", 0.0) / 100.0
    skew = (1.0 + gain) * math.sin(math.radians(p.get("skew_deg", 0.0)))
    return VectorInC(f"{c_literal(gain)} * s + {c_literal(skew)} * c", "0.0f")


EFFECT = Effect(
    name="axis_mismatch",
    title="Mismatch of the sensor's axes",
    origin="sensor",
    scope="unit",
    covariate=ELEVATION,
    parameters=(Parameter("gain_pct", "Gain error", "%"), Parameter("skew_deg", "Skew", "°")),
    formula=ON_VECTOR + "a_y → (1 + gain_pct/100)·(a_y + a_z·sin skew_deg)",
    forms=lambda r, _at: vector_forms(r, _on_vector_g, NAMES),
    scan=where_axes_show,
    on_vector_g=_on_vector_g,
    in_c=_in_c,
    apart="clamped at another angle, the unit takes it along",
    seen_by_gravity="|accelerometer| changes as gain·sin² θ and skew·sin θ·cos θ",
    remedy="correct gain and skew of the two axes in the firmware",
    possible=within(gain_pct=LARGEST_GAIN_PCT, skew_deg=LARGEST_SKEW_DEG),
)
