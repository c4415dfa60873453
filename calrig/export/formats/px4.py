"""PX4's parameters of accelerometer and gyro 0, as QGroundControl loads them.

Read of PX4-Autopilot: `src/lib/sensor_calibration/Accelerometer.hpp` and `Gyroscope.hpp` (corrected =
rotation·((data − thermal offset − offset)∘scale), the gyro without a scale; m/s², rad/s),
`src/modules/temperature_compensation/TemperatureCompensation.cpp` (thermal offset = X0 + X1·d + X2·d² + X3·d³
with d = T − TREF, T held between TMIN and TMAX) and `src/drivers/imu/invensense/mpu6000/MPU6000.cpp` (the
chip's x forward, y left, z up become x forward, y right, z down). The file: "Parameter File Format" in
QGroundControl's developer guide; the last column is MAVLink's MAV_PARAM_TYPE.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calrig.export.autopilot import parameters_of
from calrig.export.formats import CalibrationExporter
from calrig.export.triads import comments, origin_of

DRIVER_AXES = np.diag([1.0, -1.0, -1.0])
INT32, REAL32 = 6, 9
SWITCH = "TC_A_ENABLE"
"""The only one that is a whole number."""


def px4(document: Mapping[str, Any]) -> str:
    """A calibration as a file of parameters.

    Raises:
        NotHeldError: they hold nothing of it.
    """
    held = parameters_of(document, DRIVER_AXES, "px4")
    rows = held.rows("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF")
    notes = list(held.notes)
    if held.reference_c is not None:
        coldest, warmest = held.temperatures_c
        ends = (("TREF", held.reference_c), ("TMIN", coldest), ("TMAX", warmest))
        rows += [(SWITCH, 1), *((f"TC_A0_{name}", value) for name, value in ends)]
        for order in (3, 2, 1, 0):
            for place, per_c in enumerate(held.per_c_mps2.tolist()):
                rows.append((f"TC_A0_X{order}_{place}", per_c if order == 1 else 0.0))
        notes.append(
            "set TC_A0_ID to the vehicle's CAL_ACC0_ID and restart: TC_* are for the sensor of that ID"
        )
    said = [
        *origin_of(document),
        "for sensor 0, CAL_ACC0_ID and CAL_GYRO0_ID as they are on the vehicle: it must be this very chip",
        "axes: x, -y, -z of the chip, as drivers of InvenSense chips hand them on (driver option -R 0)",
        "accelerometer corrected = (raw - thermal - OFF)*SCALE; gyro corrected = raw - OFF",
        *notes,
        *held.tests(),
    ]
    head = comments(
        ["Onboard parameters for Vehicle 1", "", *said, "", "Vehicle-Id Component-Id Name Value Type"]
    )
    kinds = (INT32 if name == SWITCH else REAL32 for name, _ in rows)
    lines = (f"1\t1\t{name}\t{value:.9g}\t{kind}" for (name, value), kind in zip(rows, kinds, strict=True))
    return "\n".join([*head, *lines, ""])


EXPORTER = CalibrationExporter(
    name="px4",
    title="PX4",
    file_name="px4.params",
    contents="parameters for QGroundControl: `CAL_ACC0_*`, `CAL_GYRO0_*OFF`, `TC_A0_*`; axes x, −y, −z of "
    "the chip",
    about_one_axis="y and z; x stays as on the vehicle",
    write=px4,
)
