"""An a_y that is not linear, so that the angle is wrong by a polynomial of θ: a_y by that over cos θ."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calrig.calibration.regression.effect import ELEVATION, Effect, Parameter, Parameters, Shape
from calrig.calibration.regression.responses import Responses
from calrig.calibration.regression.terms import DEG, alike_a_drift, c_literal, one_or_both, turns
from calrig.estimation.angles import FloatArray

STEEPEST_DEG = 80.0
"""Beyond it a_y says next to nothing of the angle, and tan θ nothing of a_y."""

WIDEST_DEG = 180.0
"""Over more than half a turn a_y takes each value twice, and a polynomial of θ is not one of a_y."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if turns(r) and np.ptp(r.theta_deg) <= WIDEST_DEG:
        angle = _square_and_cube(r.theta_deg)
        # an error of a_y that turns the angle by f lengthens the vector by f·tan θ
        tangent = np.tan(np.radians(np.clip(r.theta_deg, -STEEPEST_DEG, STEEPEST_DEG)))
        norm, names = angle / DEG * tangent[:, None], ("deg_per_deg2", "deg_per_deg3")
        alike = alike_a_drift(r)
        for shape in one_or_both(angle, norm, names, at_elevation=_square_and_cube):
            yield replace(shape, alike=alike)


def _square_and_cube(theta_deg: FloatArray) -> FloatArray:
    return np.stack([theta_deg**2, theta_deg**3], 1)


def _in_c(p: Parameters) -> str:
    square, cube = (c_literal(p.get(name, 0.0)) for name in ("deg_per_deg2", "deg_per_deg3"))
    return f"({square} + {cube} * theta) * theta * theta"


EFFECT = Effect(
    name="nonlinearity",
    title="Nonlinearity of the sensor",
    origin="sensor",
    scope="unit",
    covariate=ELEVATION,
    parameters=(
        Parameter("deg_per_deg2", "Quadratic coefficient", "°/°²"),
        Parameter("deg_per_deg3", "Cubic coefficient", "°/°³"),
    ),
    formula="deg_per_deg2·θ² + deg_per_deg3·θ³",
    forms=_forms,
    on_reading_deg=lambda p: (
        p.value("deg_per_deg2") * p.theta_deg**2 + p.value("deg_per_deg3") * p.theta_deg**3
    ),
    in_c=_in_c,
    apart="clamped at another angle, the unit takes it along",
    seen_by_gravity="|accelerometer| changes as the error of the angle times tan θ",
    remedy="correct the angle by the polynomial",
)
