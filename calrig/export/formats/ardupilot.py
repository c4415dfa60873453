"""ArduPilot's INS parameters of the first IMU, as Mission Planner and MAVProxy load them.

Read of ardupilot, `libraries/AP_InertialSensor`: `AP_InertialSensor_Backend.cpp` (the sensor's own rotation,
then temperature, offset, scale, then the board's rotation; m/s², rad/s, the gyro without a scale),
`AP_InertialSensor_tempcal.cpp` (v −= p(T − 35) − p(T_cal − 35), p of orders 1 to 3 in 10⁻⁶ m/s², both
temperatures held between TMIN and TMAX) and `AP_InertialSensor_Invensense.cpp` (driver's x, y, z = chip's
y, x, −z). The file: NAME,VALUE, `#` before a comment.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calrig.export.autopilot import parameters_of
from calrig.export.formats import CalibrationExporter
from calrig.export.triads import comments, origin_of

DRIVER_AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
PER_C = 1e6
"""Coefficients of temperature are parameters in millionths."""


def ardupilot(document: Mapping[str, Any]) -> str:
    """A calibration as a file of parameters.

    Raises:
        NotHeldError: they hold nothing of it.
    """
    held = parameters_of(document, DRIVER_AXES, "ardupilot")
    rows = held.rows("INS_ACCOFFS_{}", "INS_ACCSCAL_{}", "INS_GYROFFS_{}")
    notes = list(held.notes)
    if not np.isnan(held.gyro_offset_rps).all():
        notes.append("gyro offsets are measured anew at every start unless INS_GYR_CAL is 0")
    if held.reference_c is not None:
        coldest, warmest = held.temperatures_c
        rows += [("INS_TCAL1_ENABLE", 1), ("INS_TCAL1_TMIN", coldest), ("INS_TCAL1_TMAX", warmest)]
        rows.append(("INS_ACC1_CALTEMP", held.reference_c))
        for order in (1, 2, 3):
            for axis, per_c in zip("XYZ", held.per_c_mps2, strict=True):
                rows.append((f"INS_TCAL1_ACC{order}_{axis}", per_c * PER_C if order == 1 else 0.0))
    said = [
        *origin_of(document),
        "for the first IMU, INS_ACC_ID and INS_GYR_ID as they are on the vehicle: it must be this very chip",
        "axes: y, x, -z of the chip, as drivers of InvenSense chips hand them on with ROTATION_NONE in the",
        "board's definition (hwdef); another rotation there turns these parameters with it",
        "accelerometer corrected = (raw - thermal - ACCOFFS)*ACCSCAL; gyro corrected = raw - GYROFFS",
        *notes,
        *held.tests(),
    ]
    return "\n".join([*comments(said), *(f"{name},{value:.9g}" for name, value in rows), ""])


EXPORTER = CalibrationExporter(
    name="ardupilot",
    title="ArduPilot",
    file_name="ardupilot.param",
    contents="`INS_ACCOFFS_*`, `INS_ACCSCAL_*`, `INS_GYROFFS_*`, `INS_TCAL1_*`; axes y, x, −z of the chip",
    about_one_axis="y and z; x stays as on the vehicle",
    write=ardupilot,
)
