"""A scale that follows temperature."""

from collections.abc import Iterator

from calrig.calibration.regression.effect import TEMPERATURE, Effect, Parameter, Parameters, Shape
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import c_literal, c_warmer, tilted, turns, warmer_c


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    found = warmer_c(r, at)
    if found is not None and turns(r):
        warmer, reference_c = found
        yield Shape(tilted(warmer * r.theta_deg), ("per_c",), at={"reference_c": reference_c})


EFFECT = Effect(
    name="temperature_scale",
    title="Scale that follows temperature",
    origin="sensor",
    scope="unit",
    covariate=TEMPERATURE,
    parameters=(
        Parameter("per_c", "Temperature coefficient of scale", "1/°C"),
        Parameter("reference_c", "Reference temperature", "°C"),
    ),
    formula="per_c·(T − reference_c)·θ",
    forms=_forms,
    on_reading_deg=lambda p: p.value("per_c") * p.warmer_c() * p.theta_deg,
    in_c=lambda p: f"{c_literal(p.get('per_c', 0.0))} * {c_warmer(p)} * theta",
    apart="grows with elevation and temperature together",
    remedy="wait until the unit is warm, or correct by its own thermometer",
)
