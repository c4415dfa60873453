"""What documents of solutions in the plane and of whole units say alike (CONTRACT section 8)."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from calrig.calibration.joint.elevation import Worth
from calrig.calibration.joint.held_out import HeldOut
from calrig.calibration.joint.least_squares import Fit
from calrig.calibration.joint.mapped import Mapped
from calrig.calibration.joint.three_axis_fit import ThreeAxisFit
from calrig.estimation.angles import FloatArray

Value = dict[str, float | None]
UNITS = {
    "y": ("y_mg", 1e3),
    "z": ("z_mg", 1e3),
    "gain": ("gain_pct", 1e2),
    "skew": ("skew_deg", float(np.degrees(1.0))),
    "y2": ("y_mg_per_g2", 1e3),
    "y3": ("y_mg_per_g3", 1e3),
    "z2": ("z_mg_per_g2", 1e3),
    "z3": ("z_mg_per_g3", 1e3),
    "y_per_c": ("y_mg_per_c", 1e3),
    "z_per_c": ("z_mg_per_c", 1e3),
}
"""A document's names of the parameters, and their units."""


def value(number: float, std: float | None) -> Value:
    """A parameter with its standard error."""
    return {"value": float(number), "std": None if std is None else float(std)}


def projected(coefficients: FloatArray, covariance: FloatArray, linear: bool) -> dict[str, Value]:
    """Coefficients (2,) of a polynomial of the angle and covariance (2, 2), which is none of linear units."""
    stds = [None, None] if linear else np.sqrt(np.maximum(np.diag(covariance), 0.0))
    names = ("deg_per_deg2", "deg_per_deg3")
    return {name: value(c, s) for name, c, s in zip(names, coefficients, stds, strict=True)}


def worth_document(worth: Worth) -> dict[str, Any]:
    """What a unit's elevation is worth, and where."""
    return {
        "range_deg": worth.elevation_deg[[0, -1]].tolist(),
        "elevation_std_deg": {
            "elevation_deg": worth.elevation_deg.tolist(),
            "std_deg": worth.std_deg.tolist(),
        },
    }


def stage_document(on_stage: Mapped) -> dict[str, Any]:
    """The stage's map, its harmonics and play."""
    return {
        "map": map_document(on_stage),
        "harmonics": [asdict(harmonic) for harmonic in on_stage.harmonics],
        "backlash_deg": None if on_stage.backlash is None else value(*on_stage.backlash),
    }


def map_document(on_stage: Mapped) -> dict[str, Any]:
    """The stage's error over its dial."""
    return {
        "stage_deg": on_stage.stage_deg.tolist(),
        "error_deg": on_stage.error_deg.tolist(),
        "std_deg": on_stage.std_deg.tolist(),
    }


def figures(fit: Fit | ThreeAxisFit, tested: HeldOut) -> dict[str, Any]:
    """The error of held-out poses before and after, and the noise."""
    return {
        "held_out": {"how": f"{tested.stretches} stretches of elevation", "n_poses": tested.n_poses},
        "before": {"held_out_rms_deg": tested.before_deg},
        "final": {"held_out_rms_deg": tested.final_deg},
        "noise": {
            "std_deg": float(np.degrees(fit.noise)),
            "lag1_correlation": fit.problem.correlation,
        },
    }
