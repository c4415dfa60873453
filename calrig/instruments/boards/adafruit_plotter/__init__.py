"""Adafruit's plotter example: m/s² and rad/s in one line."""

from __future__ import annotations

import math
import re

from calrig.instruments.boards.sketch import STANDARD_GRAVITY_MPS2, Sketch, board_device, line_forms

SKETCH = Sketch(
    driver="adafruit-plotter",
    source="adafruit/Adafruit_MPU6050, examples/plotter",
    baudrate=115200,
    pace="60 to 90 lines a second",
    lines=line_forms("AccelX:%,AccelY:%,AccelZ:%, GyroX:%,GyroY:%,GyroZ:%"),
    bounds=(157,) * 3 + (4.37,) * 3,
    accel=(0, 1 / STANDARD_GRAVITY_MPS2),
    gyro=(3, math.degrees(1)),
    ranges=(16, 250),
    banner=re.compile(r"^$"),  # which only ends the line that a reset cut short
    is_mute_at_reset=True,
    stops=re.compile(r"Failed to find MPU6050 chip"),
    checks_chip=True,
)
DEVICE = board_device(SKETCH)
