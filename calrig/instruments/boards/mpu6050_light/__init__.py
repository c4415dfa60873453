"""GetAngle of MPU6050_light: an angle filtered on the board, its zero where it stood at its start."""

from __future__ import annotations

import re

from calrig.instruments.boards.sketch import Sketch, board_device, line_forms

SKETCH = Sketch(
    driver="mpu6050-light",
    source="rfetick/MPU6050_light, examples/GetAngle",
    baudrate=9600,
    pace="about 33 lines a second: more do not pass at 9600 baud",
    lines=line_forms("X : %\tY : %\tZ : %"),
    bounds=(400, 400, 99999),
    angle=0,
    ranges=(2, 500),
    banner=re.compile(r"MPU6050 status: 0|Calculating offsets, do not move MPU6050|^Done!$"),
    stops=re.compile(r"MPU6050 status: [1-9]\d*"),
    zeroes_at_reset=True,
    starts_in_s=8.0,
    heard_within_s=0.6,
)
DEVICE = board_device(SKETCH)
