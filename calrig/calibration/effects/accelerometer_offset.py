"""Offsets of the accelerometer's two axes: (rad per g) y·cos θ − z·sin θ."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calrig.calibration.effect import ELEVATION, Effect, Parameter, Parameters, Shape
from calrig.calibration.effect_terms import DEG, MG, c_literal, c_turn, one_or_both, sin_cos, turns, within
from calrig.calibration.responses import Responses

LARGEST_MG = 150.0
"""MPU-6050 data sheet PS-MPU-6000A-00 rev. 3.4, section 6.2: zero-g output ±50 mg (x, y), ±80 mg (z); as
much again for soldering and mounting stress."""


def _forms(r: Responses, _at: Parameters) -> Iterator[Shape]:
    if turns(r):
        s, c = sin_cos(r)
        angle = np.stack([c, -s], 1) * DEG * MG
        yield from one_or_both(angle, np.stack([s, c], 1) * MG, ("y_mg", "z_mg"))


def _in_c(p: Parameters) -> str:
    y, z = (c_literal(p.get(name, 0.0) / 1e3) for name in ("y_mg", "z_mg"))
    return c_turn(f"{y} * c - {z} * s", f"{y} * s + {z} * c")


EFFECT = Effect(
    name="accelerometer_offset",
    title="Offset of the accelerometer",
    origin="sensor",
    scope="unit",
    covariate=ELEVATION,
    parameters=(Parameter("y_mg", "Offset of y", "mg"), Parameter("z_mg", "Offset of z", "mg")),
    formula="atan2(y·cos θ − z·sin θ, 1 + y·sin θ + z·cos θ), y = y_mg/1000, z = z_mg/1000",
    forms=_forms,
    on_reading_deg=lambda p: p.turn_deg(p.value("y_mg") / 1e3, p.value("z_mg") / 1e3),
    in_c=_in_c,
    apart="|accelerometer| changes as y·sin θ + z·cos θ",
    remedy="subtract the offsets in the firmware, or calibrate against gravity",
    possible=within(y_mg=LARGEST_MG, z_mg=LARGEST_MG),
)
