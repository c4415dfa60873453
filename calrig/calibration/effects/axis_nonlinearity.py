"""Quadratic and cubic terms of the accelerometer's two axes, each in the acceleration along it.

Solved for where mounts take the unit through the turn (`calibration.joint`); over ±60° the diagnosis has the
polynomial of `nonlinearity`, which is all that such poses tell. An axis that lies askew by `skew_deg` feels
u = a_y + a_z·sin skew_deg, which is the same angle as in `axis_mismatch`.
"""

from __future__ import annotations

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
    y = p.value("y_mg_per_g2") * u**2 + p.value("y_mg_per_g3") * u**3
    z = p.value("z_mg_per_g2") * c**2 + p.value("z_mg_per_g3") * c**3
    return MG * y, MG * z


def _in_c(p: Parameters) -> VectorInC:
    y2, y3, z2, z3 = (
        c_literal(MG * p.get(name, 0.0))
        for name in ("y_mg_per_g2", "y_mg_per_g3", "z_mg_per_g2", "z_mg_per_g3")
    )
    u = f"(s + {c_literal(math.sin(math.radians(p.get('skew_deg', 0.0))))} * c)"
    return VectorInC(f"({y2} + {y3} * {u}) * {u} * {u}", f"({z2} + {z3} * c) * c * c")


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
        Parameter("skew_deg", "Skew", "°"),
    ),
    formula=ON_VECTOR
    + "a_y + (y_mg_per_g2·u² + y_mg_per_g3·u³)/1000, a_z + (z_mg_per_g2·a_z² + z_mg_per_g3·a_z³)/1000, "
    "u = a_y + a_z·sin skew_deg",
    forms=lambda _r, _at: iter(()),  # poses on one mount do not part it from the stage: never searched for
    on_vector_g=_on_vector_g,
    in_c=_in_c,
    apart="the unit clamped at several angles parts it from the stage (`calrig solve`)",
    remedy="correct the two axes by their polynomials in the firmware",
)
