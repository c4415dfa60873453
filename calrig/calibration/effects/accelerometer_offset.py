"""Offsets of the accelerometer's two axes: (rad per g) y·cos θ − z·sin θ."""

from calrig.calibration.regression.effect import (
    ELEVATION,
    Applied,
    Effect,
    Parameter,
    Shape,
    VectorError,
    VectorInC,
)
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import (
    MG,
    ON_VECTOR,
    c_literal,
    said_of_two_signals,
    vector_forms,
    where_axes_show,
    within,
)

NAMES = ("y_mg", "z_mg")
LARGEST_MG = 150.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: zero-g output ±50 mg (x, y), ±80 mg (z); as
much again for soldering and mounting stress."""


def _on_vector_g(p: Applied) -> VectorError:
    return p.value(NAMES[0]) * MG, p.value(NAMES[1]) * MG


def _evidence(r: Responses, shape: Shape) -> list[str]:
    unread = said_of_two_signals(r, shape)
    return unread or ["a calibration against gravity (`calrig gravity`) measures the offsets without a stage"]


EFFECT = Effect(
    name="accelerometer_offset",
    title="Offset of the sensor's axes",
    origin="sensor",
    scope="unit",
    covariate=ELEVATION,
    parameters=(Parameter(NAMES[0], "Offset of y", "mg"), Parameter(NAMES[1], "Offset of z", "mg")),
    formula=ON_VECTOR + "a_y + y_mg/1000, a_z + z_mg/1000",
    forms=lambda r, _at: vector_forms(r, _on_vector_g, NAMES),
    scan=where_axes_show,
    on_vector_g=_on_vector_g,
    in_c=lambda p: VectorInC(*(c_literal(p.get(name, 0.0) * MG) for name in NAMES)),
    apart="clamped at another angle, the unit takes it along",
    seen_by_gravity="|accelerometer| changes as y·sin θ + z·cos θ",
    remedy="subtract the offsets in the firmware",
    evidence=_evidence,
    possible=within(y_mg=LARGEST_MG, z_mg=LARGEST_MG),
)
