"""ElectronicCats/mpu6050 MPU6050_raw: without a pause, and it stops at a clone."""

from __future__ import annotations

from calrig.simulator.boards.i2cdev_raw import Raw
from calrig.simulator.sketch import Found, Motion, lines
from calrig.simulator.sketch_board import running


class FastRaw(Raw):
    """That sketch."""

    driver = "i2cdev-raw"
    pause_s = 0.0

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        told = lines("Initializing MPU...", "Testing MPU6050 connection...")
        if not (found.sensor and found.genuine):
            return told + lines("MPU6050 connection failed"), False
        offsets = lines("Updating internal sensor offsets...\n") + "\t0\t0\t0\t0\t0\t0\n"
        return told + lines("MPU6050 connection successful") + offsets, True


BOARD = running(FastRaw)
