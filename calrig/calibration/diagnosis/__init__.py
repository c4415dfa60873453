"""Trace the residual of runs to physical effects: search, significance, held-out error, report."""

from calrig.calibration.diagnosis.experiment_design import FollowUp, SequentialTest, design
from calrig.calibration.diagnosis.joint_effects import (
    Growth,
    JointEffects,
    RunOfEffects,
    fit_together,
    held_out_growth,
)
from calrig.calibration.diagnosis.report import (
    DrawnResiduals,
    PartialResidual,
    drawn_residuals,
    partial_residuals,
)
from calrig.calibration.diagnosis.selection import Findings
from calrig.calibration.diagnosis.tracing import MOST_POSES, diagnose, trace
