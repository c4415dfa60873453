"""Separate the errors of stage, mounts and units by one least squares (CONTRACT section 8)."""

from __future__ import annotations

from calrig.calibration.separation.gravity import calibrate_by_gravity, gravity_document
from calrig.calibration.separation.level import ElevationUncertainty
from calrig.calibration.separation.map_report import mapped
from calrig.calibration.separation.map_validity import MapCheck, checked
from calrig.calibration.separation.messages import advised
from calrig.calibration.separation.pose_table import MountedPoses, Table
from calrig.calibration.separation.report import (
    Value,
    level_document,
    map_document,
    parameters_of,
    pose_residuals,
    solution_document,
    uncertainty_document,
)
from calrig.calibration.separation.solution import Solution, solve
from calrig.calibration.separation.stage_reference import (
    MAP_SCHEMA,
    MapError,
    StageMap,
    beyond_in_words,
    dial_of,
    in_words,
    map_reference,
    with_map,
)
from calrig.calibration.separation.three_axis_fit import ThreeAxisSolution, solve_whole
from calrig.calibration.separation.three_axis_frame import Frame
from calrig.calibration.separation.three_axis_report import (
    WholeUnit,
    accelerometer_document,
    gyro_document,
    plane_parameters,
    three_axis_document,
    units_of,
)
from calrig.calibration.separation.three_axis_table import FACES, whole_units
from calrig.calibration.separation.unit_model import NAMES

__all__ = [
    "FACES",
    "MAP_SCHEMA",
    "NAMES",
    "ElevationUncertainty",
    "Frame",
    "MapCheck",
    "MapError",
    "MountedPoses",
    "Solution",
    "StageMap",
    "Table",
    "ThreeAxisSolution",
    "Value",
    "WholeUnit",
    "accelerometer_document",
    "advised",
    "beyond_in_words",
    "calibrate_by_gravity",
    "checked",
    "dial_of",
    "gravity_document",
    "gyro_document",
    "in_words",
    "level_document",
    "map_document",
    "map_reference",
    "mapped",
    "parameters_of",
    "plane_parameters",
    "pose_residuals",
    "solution_document",
    "solve",
    "solve_whole",
    "three_axis_document",
    "uncertainty_document",
    "units_of",
    "whole_units",
    "with_map",
]
