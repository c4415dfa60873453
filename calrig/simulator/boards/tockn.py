"""tockn/MPU6050_tockn examples/GetAngle: takes the gyro's zero at its start, its level from gravity."""

from __future__ import annotations

import math
from collections.abc import Callable

from calrig.simulator.sketch_board import Complementary, Found, Motion, Setup, lines, running


class Tockn(Complementary):
    """That sketch. Its banner's last line has no end."""

    driver = "tockn"
    baudrate, pause_s = 9600, 0.002

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: ARG002, D102
        self.begin(read())
        yield "", 1.0
        yield lines("", "=" * 40, "Calculating gyro offsets") + "DO NOT MOVE MPU6050.", 0.323
        yield ".", 0.323
        yield ".", 0.323
        self.zero(read())
        offsets = [f"{a} : {o:.2f}" for a, o in zip("XYZ", self._gyro_offset, strict=True)]
        yield lines("", "Done!", *offsets, "Program will start after 3 seconds") + "=" * 40, 3.0

    def tilt(self, motion: Motion) -> tuple[float, float]:  # noqa: D102
        x, y, z = motion.accel_g
        roll, pitch = math.atan2(y, math.hypot(x, z)), -math.atan2(x, math.hypot(y, z))
        return math.degrees(roll), math.degrees(pitch)

    def record(self, motion: Motion) -> str:  # noqa: D102
        x, y, z = self.angles(motion)
        return lines(f"angleX : {x:.2f}\tangleY : {y:.2f}\tangleZ : {z:.2f}")


BOARD = running(Tockn)
