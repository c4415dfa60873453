"""MPU6050_raw of i2cdevlib and of ElectronicCats: registers, without temperature."""

from __future__ import annotations

import re

from calrig.instruments.boards.sketch import Sketch, board_device, line_forms

SKETCH = Sketch(
    driver="i2cdev-raw",
    source="jrowberg/i2cdevlib or ElectronicCats/mpu6050, MPU6050_raw",
    baudrate=38400,
    pace="10 lines a second, ElectronicCats' about 110",
    lines=line_forms("a/g:" + "\t#" * 6),
    bounds=(32768,) * 6,
    accel=(0, 1 / 16384),
    gyro=(3, 1 / 131),
    banner=re.compile(
        r"Initializing (I2C devices|MPU)\.\.\.|Testing (device connections|MPU6050 connection)\.\.\."
        r"|MPU6050 connection successful|Updating internal sensor offsets"
    ),
    remarks=re.compile(r"MPU6050 connection failed"),
    mute="ElectronicCats' sketch stops where WHO_AM_I is not an MPU-6050's: check the sensor's wires",
    frozen_after_s=0.0,
)
DEVICE = board_device(SKETCH)
