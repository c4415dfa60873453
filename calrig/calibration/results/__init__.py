"""A run's result, and a calibration applied: bias, scale, effects, errors of indication."""

from __future__ import annotations

from calrig.calibration.results.correction import (
    AT_ITS_END_DEG,
    HALF_TURN_DEG,
    Application,
    AppliedEffect,
    columns_followed,
    effects_at_rest,
    effects_on_reading_deg,
    felt_elevation_deg,
    numbers_of,
    own_effect,
    reference_temperature_c,
    spans_more_than_a_turn,
)
from calrig.calibration.results.pose_errors import (
    as_clamped,
    corrected_residuals_deg,
    raw_error_deg,
    residuals,
)
from calrig.calibration.results.result import UNKNOWN_GYRO, FittedResult, apply_calibration, build_result

__all__ = [
    "AT_ITS_END_DEG",
    "HALF_TURN_DEG",
    "UNKNOWN_GYRO",
    "Application",
    "AppliedEffect",
    "FittedResult",
    "apply_calibration",
    "as_clamped",
    "build_result",
    "columns_followed",
    "corrected_residuals_deg",
    "effects_at_rest",
    "effects_on_reading_deg",
    "felt_elevation_deg",
    "numbers_of",
    "own_effect",
    "raw_error_deg",
    "reference_temperature_c",
    "residuals",
    "spans_more_than_a_turn",
]
