"""A solution that is kept, for tests that are about its map and not about how it was found."""

from __future__ import annotations

import numpy as np

from calrig.canonical_json import sha256_of
from calrig.store.records import Basis, Solved

ORDERS = [1.0, 2.0, 3.0]
STD_DEG = 0.004


def solved(rig: str = "bench-1", *, separable: bool = True) -> Solved:
    """A solution whose map is worth 0.004° at every cosine and sine."""
    dial = np.linspace(-60.0, 60.0, 61)
    content = {
        "schema": "calrig.stage-map/1",
        "rig": None,
        "orders": ORDERS,
        "coefficients_deg": [0.0, 0.05, 0.02, 0.0, 0.0, -0.01, 0.0],
        "covariance_deg2": (STD_DEG**2 * np.eye(7)).tolist(),
        "map": {"stage_deg": dial.tolist(), "error_deg": [0.0] * 61, "std_deg": [STD_DEG] * 61},
        "units": ["M-1"],
        "solved_from": ["a", "b", "c"],
        "separable": separable,
    }
    stage_map = {**content, "sha256": sha256_of(content)}
    document = {"separable": separable, "advice": {"says": "unit M-1 clamped at 0°, 120°, 240°"}}
    return Solved(rig, Basis(("a", "b", "c"), ("M-1",)), document, {}, stage_map, {})
