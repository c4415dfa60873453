"""ElectronicCats/mpu6050 MPU6050_raw: without a pause, and it stops at a clone."""

from __future__ import annotations

from collections.abc import Callable

from calrig.simulator.boards.i2cdev_raw import Raw
from calrig.simulator.sketch_board import Found, Motion, Setup, lines, running, stop


class FastRaw(Raw):
    """That sketch."""

    pause_s = 0.009

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: ARG002, D102
        yield lines("Initializing MPU...", "Testing MPU6050 connection..."), 0.0
        if not (found.sensor and found.genuine):
            yield from stop(lines("MPU6050 connection failed"))
        offsets = lines("Updating internal sensor offsets...\n") + "\t0\t0\t0\t0\t0\t0\n"
        yield lines("MPU6050 connection successful") + offsets, 0.0


BOARD = running(FastRaw)
