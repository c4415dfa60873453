"""Adafruit's basic_readings example: a record of four lines, with temperature."""

from __future__ import annotations

import math
import re

from calrig.instruments.boards.sketch import STANDARD_GRAVITY_MPS2, Sketch, board_device, line_forms

SKETCH = Sketch(
    driver="adafruit-basic",
    source="adafruit/Adafruit_MPU6050, examples/basic_readings",
    baudrate=115200,
    pace="2 records a second",
    lines=line_forms(
        "Acceleration X: %, Y: %, Z: % m/s^2", "Rotation X: %, Y: %, Z: % rad/s", "Temperature: % degC", ""
    ),
    bounds=(78.6,) * 3 + (8.74,) * 3 + (133,),
    accel=(0, 1 / STANDARD_GRAVITY_MPS2),
    gyro=(3, math.degrees(1)),
    temperature=6,
    ranges=(8, 500),
    banner=re.compile(
        r"Adafruit MPU6050 test!|MPU6050 Found!|(Accelerometer|Gyro) range set to: |Filter bandwidth set to: "
    ),
    stops=re.compile(r"Failed to find MPU6050 chip"),
    checks_chip=True,
    heard_within_s=1.0,
)
DEVICE = board_device(SKETCH)
