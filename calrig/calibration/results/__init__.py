"""A run's result, and a calibration applied: bias, scale, effects, errors of indication."""

from calrig.calibration.results.correction import (
    Application,
    AppliedEffect,
    columns_followed,
    effects_at_rest,
    effects_on_reading_deg,
    felt_elevation_deg,
    fit_line_with_effects,
    numbers_of,
    own_effect,
    reference_temperature_c,
    unit_slopes,
)
from calrig.calibration.results.pose_errors import (
    angles_deg,
    as_clamped,
    circumstances,
    corrected_residuals_deg,
    nominal_deg,
    poses_without_effects,
    raw_error_deg,
    readings_left_deg,
    residuals,
)
from calrig.calibration.results.reading_turns import (
    AT_ITS_END_DEG,
    HALF_TURN_DEG,
    ReadingTurns,
    readings_wrap,
)
from calrig.calibration.results.result import (
    UNKNOWN_GYRO,
    EffectDoubt,
    FittedResult,
    apply_calibration,
    build_result,
)
from calrig.calibration.results.verification import Promise, basis_of_poses, of_line_alone, verify
