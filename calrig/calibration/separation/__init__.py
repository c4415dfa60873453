"""Separate the errors of stage, mounts and units by one least squares (CONTRACT section 8)."""

from calrig.calibration.separation.clamping import FACES
from calrig.calibration.separation.gravity import calibrate_by_gravity, gravity_document
from calrig.calibration.separation.map_report import mapped
from calrig.calibration.separation.map_validity import ORDERS as CHECKED_ORDERS
from calrig.calibration.separation.map_validity import MapCheck, checked
from calrig.calibration.separation.messages import advised
from calrig.calibration.separation.pose_table import MountedPoses, Table, are_whole
from calrig.calibration.separation.report import (
    WholeUnit,
    accelerometer_document,
    gyro_document,
    level_document,
    map_document,
    parameters_of,
    pose_residuals,
    solution_document,
    uncertainty_document,
    whole_units,
)
from calrig.calibration.separation.solution import Solution, solve
from calrig.calibration.separation.stage_map import (
    MAP_SCHEMA,
    MapError,
    StageMap,
    beyond_in_words,
    dial_of,
    in_words,
    local_document,
    map_reference,
    with_map,
)
from calrig.calibration.separation.unit_results import ElevationUncertainty
