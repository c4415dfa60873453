"""Quadratic, cubic and quartic terms of the accelerometer's two axes, each in the acceleration along it.

Solved for where mounts take the unit through the turn (`calibration.joint`); over ±60° the diagnosis has the
polynomial of `nonlinearity`, which is all that such poses tell. An axis that lies askew by `skew_deg` feels
u = a_y + a_z·sin skew_deg, which is the same angle as in `axis_mismatch`.
"""

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
from calrig.calibration.regression.terms import MG, ON_VECTOR, c_literal


def _on_vector_g(p: Applied) -> VectorError:
    s, c = p.sin_cos()
    u = s + c * np.sin(np.radians(p.value("skew_deg")))
    y, z = (
        p.value(f"{axis}_mg_per_g2") * along**2
        + p.value(f"{axis}_mg_per_g3") * along**3
        + p.value(f"{axis}_mg_per_g4") * along**4
        for axis, along in (("y", u), ("z", c))
    )
    return MG * y, MG * z


def _in_c(p: Parameters) -> VectorInC:
    y2, y3, y4, z2, z3, z4 = (
        c_literal(MG * p.get(f"{axis}_mg_per_g{power}", 0.0)) for axis in "yz" for power in (2, 3, 4)
    )
    u = f"(s + {c_literal(math.sin(math.radians(p.get('skew_deg', 0.0))))} * c)"
    return VectorInC(
        f"({y2} + ({y3} + {y4} * {u}) * {u}) * {u} * {u}", f"({z2} + ({z3} + {z4} * c) * c) * c * c"
    )


EFFECT = Effect(
    name="axis_nonlinearity",
    title="Nonlinearity of the accelerometer's axes",
    origin="sensor",
    scope="unit",
    covariate=ELEVATION,
    parameters=(
        Parameter("y_mg_per_g2", "Quadratic term of y", "mg/g²"),
        Parameter("y_mg_per_g3", "Cubic term of y", "mg/g³"),
        Parameter("z_mg_per_g2", "Quadratic term of z", "mg/g²"),
        Parameter("z_mg_per_g3", "Cubic term of z", "mg/g³"),
        Parameter("y_mg_per_g4", "Quartic term of y", "mg/g⁴"),
        Parameter("z_mg_per_g4", "Quartic term of z", "mg/g⁴"),
        Parameter("skew_deg", "Skew", "°"),
    ),
    formula=ON_VECTOR + "a_y + (y_mg_per_g2·u² + y_mg_per_g3·u³ + y_mg_per_g4·u⁴)/1000, "
    "a_z + (z_mg_per_g2·a_z² + z_mg_per_g3·a_z³ + z_mg_per_g4·a_z⁴)/1000, "
    "u = a_y + a_z·sin skew_deg",
    forms=lambda _r, _at: iter(()),  # poses on one mount do not part it from the stage: never searched for
    on_vector_g=_on_vector_g,
    in_c=_in_c,
    apart="the unit clamped at several angles parts it from the stage (`calrig solve`)",
    remedy="correct the two axes by their polynomials in the firmware",
)
