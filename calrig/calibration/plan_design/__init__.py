"""Design the shortest plan that reaches an uncertainty on a rig (CONTRACT section 9)."""

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
