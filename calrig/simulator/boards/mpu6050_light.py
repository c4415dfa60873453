"""rfetick/MPU6050_light examples/GetAngle: takes where it starts for level, asks no WHO_AM_I."""

from __future__ import annotations

import math
from collections.abc import Callable

from calrig.simulator.sketch_board import Complementary, Found, Motion, Setup, lines, running, stop


class Light(Complementary):
    """That sketch. It reads and filters while its print is due in 10 ms, so that its filter is a fast one."""

    driver = "mpu6050-light"
    baudrate, pause_s, reads = 9600, 0.0014, 8

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: D102
        if not found.sensor:
            yield from stop(lines("MPU6050 status: 2"))
        self.begin(read())
        yield lines("MPU6050 status: 0", "Calculating offsets, do not move MPU6050"), 1.85
        self.zero(read(), accel=True)
        yield "Done!\n\r\n", 0.0

    def tilt(self, motion: Motion) -> tuple[float, float]:  # noqa: D102
        x, y, z = motion.accel_g
        roll = math.atan2(y, math.copysign(math.hypot(x, z), z))
        return math.degrees(roll), math.degrees(-math.atan2(x, math.hypot(y, z)))

    def record(self, motion: Motion) -> str:  # noqa: D102
        x, y, z = self.angles(motion)
        return lines(f"X : {x:.2f}\tY : {y:.2f}\tZ : {z:.2f}")


BOARD = running(Light)
