"""Calibration documents made of known truth."""

from __future__ import annotations

from typing import Any

import numpy as np

from calrig.canonical_json import sha256_of

BIAS_G = np.array([0.012, -0.03, 0.05])
MATRIX = np.array([[0.991, 0.004, -0.003], [0.0, 1.013, 0.006], [0.0, 0.0, 0.984]])
"""true = MATRIX·(raw − BIAS_G)."""
GYRO_BIAS_DPS = np.array([1.4, -0.6, 0.3])
PLANAR = [
    ("accelerometer_offset", {"y_mg": 12.0, "z_mg": -25.0}),
    ("axis_mismatch", {"gain_pct": -0.9, "skew_deg": 0.4}),
]
WARM = ("temperature_offset", {"y_mg_per_c": 0.35, "z_mg_per_c": -0.2, "reference_c": 25.0})


def issued(effects: Any = (), **changes: Any) -> dict[str, Any]:
    """A document as one is issued, its hash with it."""
    document = {
        "schema": "calrig.calibration/2",
        "unit": "AS-0042",
        "revision": 3,
        "issued_at": "2026-11-20T09:05:00Z",
        "run_id": "17",
        "calibrated_at": "2026-11-20T09:03:20Z",
        "rig": "bench-1",
        "range_deg": [-60.0, 60.0],
        "bias_deg": 0.25,
        "scale": 1.002,
        "covariance": [[1.6e-5, 0.0], [0.0, 1.2e-8]],
        "effects": [{"name": name, "parameters": parameters} for name, parameters in effects],
        "gyro": {"bias_dps": GYRO_BIAS_DPS.tolist(), "scale": 1.002},
        "expanded_uncertainty_deg": None,
        "coverage_factor": None,
        "level_known": False,
        "level_std_deg": None,
        "accelerometer": None,
        "uncertainty": {"type_a_deg": 0.03, "type_b_deg": 0.02},
        "temperature_c": {"min": 20.0, "max": 30.0},
        **changes,
    }
    return {**document, "sha256": sha256_of(document)}


def whole(**changes: Any) -> dict[str, Any]:
    """One with the whole accelerometer, which bias, scale and effects have nothing beside."""
    accelerometer = {"bias_g": BIAS_G.tolist(), "matrix": MATRIX.tolist()}
    return issued(**{"bias_deg": 0.0, "scale": 1.0, "accelerometer": accelerometer, **changes})
