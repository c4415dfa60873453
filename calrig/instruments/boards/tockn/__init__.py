"""GetAngle of MPU6050_tockn: an angle filtered on the board, which takes the gyro's zero at its start."""

from __future__ import annotations

import re

from calrig.instruments.boards.sketch import Sketch, board_device, line_forms

SKETCH = Sketch(
    driver="tockn",
    source="tockn/MPU6050_tockn, examples/GetAngle",
    baudrate=9600,
    pace="about 22 lines a second: more do not pass at 9600 baud",
    lines=line_forms("angleX : %\tangleY : %\tangleZ : %"),
    bounds=(400, 400, 99999),
    angle=0,
    ranges=(2, 500),
    banner=re.compile(
        r"={40}|[Cc]alculat(e|ing) gyro offsets|DO NOT MOVE (A )?MPU6050|^Done!+$"
        r"|Program will start after 3 seconds"
    ),
    zeroes_at_reset=True,
    starts_in_s=18.0,
    heard_within_s=0.6,
)
DEVICE = board_device(SKETCH)
