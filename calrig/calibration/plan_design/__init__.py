"""Design the shortest plan that reaches an uncertainty on a rig (CONTRACT section 9)."""

from __future__ import annotations

from calrig.calibration.plan_design.design import ended, limit_s, quickest, within
from calrig.calibration.plan_design.design_problem import (
    Design,
    DesignProblem,
    Goals,
    OutOfReachError,
    Sweeping,
    TypeB,
)
from calrig.calibration.plan_design.layout import NOT_MEASURED, Pace, Precision, Turning, precision_of_run
from calrig.calibration.plan_design.settling import GAIN_ERROR, LEAST_S, SHARE, Gyro, forgotten_s, ring_down_s

__all__ = [
    "GAIN_ERROR",
    "LEAST_S",
    "NOT_MEASURED",
    "SHARE",
    "Design",
    "DesignProblem",
    "Goals",
    "Gyro",
    "OutOfReachError",
    "Pace",
    "Precision",
    "Sweeping",
    "Turning",
    "TypeB",
    "ended",
    "forgotten_s",
    "limit_s",
    "precision_of_run",
    "quickest",
    "ring_down_s",
    "within",
]
