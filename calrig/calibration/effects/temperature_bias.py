"""A package or a mount that turns with temperature.

Documents of before version 0.2 know the y axis's own offset as this with `of_axis_y`: applied, found no more.
"""

import math
from collections.abc import Iterator

import numpy as np

from calrig.calibration.regression.effect import TEMPERATURE, Effect, Parameter, Parameters, Shape, VectorInC
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import c_literal, c_warmer, tilted, warmer_c, within

LARGEST_DEG_PER_C = 1.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: zero-g output ±60 mg over 70 °C, 0.05°/°C;
twenty times as much, for mounts that turn with temperature."""


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    found = warmer_c(r, at)
    if found is None:
        return
    warmer, reference_c = found
    yield Shape(tilted(warmer), ("deg_per_c",), at={"reference_c": reference_c})


def _in_c(p: Parameters) -> str | VectorInC:
    deg_per_c = p.get("deg_per_c", 0.0)
    if not p.get("of_axis_y"):
        return f"{c_literal(deg_per_c)} * {c_warmer(p)}"
    return VectorInC(f"{c_literal(math.radians(deg_per_c))} * {c_warmer(p)}", "0.0f")


EFFECT = Effect(
    name="temperature_bias",
    title="Bias that follows temperature",
    origin="sensor",
    scope="unit",
    covariate=TEMPERATURE,
    parameters=(
        Parameter("deg_per_c", "Temperature coefficient", "°/°C"),
        Parameter("reference_c", "Reference temperature", "°C"),
        Parameter("of_axis_y", "Of the y axis", "", flag=True),
    ),
    formula="β = deg_per_c·(T − reference_c); with of_axis_y, a_y + β·π/180 instead",
    forms=_forms,
    on_reading_deg=lambda p: p.value("deg_per_c") * p.warmer_c() * (not p.value("of_axis_y")),
    on_vector_g=lambda p: (
        np.radians(p.value("deg_per_c")) * p.warmer_c() * bool(p.value("of_axis_y")),
        0.0,
    ),
    in_c=_in_c,
    apart="a second warm-up, or cooling back, tells temperature from time",
    remedy="wait until the unit is warm, or correct by its own thermometer",
    possible=within(deg_per_c=LARGEST_DEG_PER_C),
)
