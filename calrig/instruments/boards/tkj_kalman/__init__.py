"""TKJElectronics' Kalman filter example: an angle filtered on the board."""

from __future__ import annotations

import re

from calrig.instruments.boards.sketch import Sketch, board_device, line_forms

SKETCH = Sketch(
    driver="tkj-kalman",
    source="TKJElectronics/KalmanFilter, examples/MPU6050",
    baudrate=115200,
    pace="about 150 lines a second",
    lines=line_forms("%\t%\t%\t%\t\t%\t%\t%\t%\t"),
    bounds=(180, 400, 400, 400, 180, 400, 400, 400),
    angle=3,
    stops=re.compile(r"Error reading sensor"),
    remarks=re.compile(r"i2c(Read|Write) (failed: \d|timeout)"),
    mute="this sketch falls silent where the sensor's bus hangs: check the sensor's wires",
    is_mute_at_reset=True,
    settles_s=2.0,
    checks_chip=True,
)
DEVICE = board_device(SKETCH)
