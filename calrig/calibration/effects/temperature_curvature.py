"""The second-order term of a bias that follows temperature."""

from collections.abc import Iterator

from calrig.calibration.regression.effect import TEMPERATURE, Effect, Parameter, Parameters, Shape
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import (
    c_literal,
    c_warmer,
    one_leg,
    said_of_one_leg,
    tilted,
    warmer_c,
)


def _forms(r: Responses, at: Parameters) -> Iterator[Shape]:
    found = warmer_c(r, at)
    if found is None:
        return
    warmer, reference_c = found
    if "reference_c" not in at:
        # about where the square says nothing of the linear coefficient, which keeps its value
        shift = float((warmer**3).sum() / (2.0 * (warmer**2).sum()))
        warmer, reference_c = warmer - shift, reference_c + shift
    alike = ("thermal_hysteresis",) if one_leg(r) else ()
    yield Shape(tilted(warmer**2), ("deg_per_c2",), at={"reference_c": reference_c}, alike=alike)


EFFECT = Effect(
    name="temperature_curvature",
    title="Bias that follows temperature squared",
    origin="sensor",
    scope="unit",
    covariate=TEMPERATURE,
    parameters=(
        Parameter("deg_per_c2", "Quadratic temperature coefficient", "°/°C²"),
        Parameter("reference_c", "Reference temperature", "°C"),
    ),
    formula="deg_per_c2·(T − reference_c)²",
    forms=_forms,
    on_reading_deg=lambda p: p.value("deg_per_c2") * p.warmer_c() ** 2,
    in_c=lambda p: f"{c_literal(p.get('deg_per_c2', 0.0))} * {c_warmer(p)} * {c_warmer(p)}",
    apart="what is left once the linear coefficient is taken out; cooling back parts it from a delay",
    remedy="correct by the unit's own thermometer with both terms",
    evidence=said_of_one_leg,
    follows="temperature_bias",
    together_with=("temperature_bias",),
)
