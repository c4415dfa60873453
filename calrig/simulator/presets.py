"""Rigs that need no description: `ideal` to check physics against, `demo` to show what calrig is for."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "ideal": {"imu": {"accel_noise_ug_per_rthz": 0.0, "gyro_noise_dps_per_rthz": 0.0}},
    # A stage of the 0.5° class and an ordinary breakout board: mount offset and gyro bias are what a
    # calibration expects; backlash, eccentricity, offset and temperature are what it is not told about.
    "demo": {
        "seed": 1,
        "time_scale": 6.0,
        "stage": {"velocity_dps": 30.0, "acceleration_dps2": 90.0, "homing_velocity_dps": 15.0},
        "mechanics": {
            "backlash_deg": 0.12,
            "eccentricity_deg": 0.12,
            "eccentricity_phase_deg": 70.0,
            "encoder_resolution_deg": 0.001,
        },
        "mount": {"offset_deg": 0.8},
        "clamp": {},
        "environment": {
            "start_c": 24.0,
            "end_c": 38.0,
            "warm_up_s": 600.0,
            "ambient_amplitude_c": 1.5,
            "ambient_period_s": 900.0,
        },
        "imu": {
            "accel_bias_mg": [4.0, -2.0, 3.0],
            "accel_bias_mg_per_c": [0.0, 0.25, 0.0],
            "gyro_bias_dps": [1.4, -0.6, 0.3],
            "gyro_bias_dps_per_c": [0.01, 0.0, 0.0],
            "gyro_scale_error_pct": [0.8, 0.0, 0.0],
            "gyro_walk_dps_per_rts": 0.0005,
            "temperature_noise_c": 0.02,
        },
    },
}
