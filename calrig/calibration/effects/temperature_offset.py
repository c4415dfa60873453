"""Offsets of the accelerometer's two axes that move with temperature: each a tempco in mg/°C."""

from calrig.calibration.regression.effect import (
    TEMPERATURE,
    Applied,
    Effect,
    Parameter,
    VectorError,
    VectorInC,
)
from calrig.calibration.regression.terms import (
    MG,
    ON_VECTOR,
    c_literal,
    c_warmer,
    said_of_two_signals,
    warm_vector_forms,
    within,
)

NAMES = ("y_mg_per_c", "z_mg_per_c")
LARGEST_MG_PER_C = 10.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: ±60 mg over 70 °C, 0.9 mg/°C;
ten times as much."""


def _on_vector_g(p: Applied) -> VectorError:
    warmer = p.warmer_c() * MG
    return p.value("y_mg_per_c") * warmer, p.value("z_mg_per_c") * warmer


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
    formula=ON_VECTOR + "a_y + y_mg_per_c/1000·(T − reference_c), a_z + z_mg_per_c/1000·(T − reference_c)",
    forms=lambda r, at: warm_vector_forms(r, at, _on_vector_g, NAMES),
    on_vector_g=_on_vector_g,
    in_c=lambda p: VectorInC(*(f"{c_literal(p.get(name, 0.0) * MG)} * {c_warmer(p)}" for name in NAMES)),
    apart="clamped at another angle, the unit takes it along",
    seen_by_gravity="|accelerometer| changes with temperature as y·sin θ + z·cos θ",
    remedy="wait until the unit is warm, or correct the offsets by its own thermometer",
    together_with=("accelerometer_offset",),
    evidence=said_of_two_signals,
    possible=within(y_mg_per_c=LARGEST_MG_PER_C, z_mg_per_c=LARGEST_MG_PER_C),
)
