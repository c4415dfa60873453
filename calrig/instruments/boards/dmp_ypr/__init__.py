"""MPU6050_DMP6 of i2cdevlib and of ElectronicCats: yaw, pitch and roll of the chip's own processor."""

from __future__ import annotations

import re

from calrig.instruments.boards.sketch import Sketch, board_device, line_forms

SKETCH = Sketch(
    driver="dmp-ypr",
    source="jrowberg/i2cdevlib or ElectronicCats/mpu6050, MPU6050_DMP6",
    baudrate=115200,
    pace="100 lines a second",
    lines=line_forms("ypr\t%\t%\t%"),
    bounds=(180, 180, 180),
    angle=2,
    ranges=(2, 2000),
    banner=re.compile(
        r"Initializing (I2C devices|DMP)\.\.\.|Testing (device connections|MPU6050 connection)\.\.\."
        r"|MPU6050 connection successful|Send any character to begin|Enabling (DMP|interrupt detection)"
        r"|^>[*.]*>[*.]*(-?\d+\.0{5}(,\t)?){6}$|DMP ready! Waiting for first interrupt"
        r"|These are the Active offsets"
    ),
    stops=re.compile(r"DMP Initialization failed \(code \d+\)"),
    remarks=re.compile(r"MPU6050 connection failed|FIFO overflow!"),
    mute="ElectronicCats' sketch stops where WHO_AM_I is not an MPU-6050's: check the sensor's wires",
    zeroes_at_reset=True,
    wake=b"s",
    starts_in_s=15.0,
)
DEVICE = board_device(SKETCH)
