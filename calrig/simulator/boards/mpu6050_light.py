"""rfetick/MPU6050_light examples/GetAngle: takes where it starts for level, asks no WHO_AM_I."""

from __future__ import annotations

from calrig.simulator.sketch import Complementary, Found, Motion, lines
from calrig.simulator.sketch_board import running


class Light(Complementary):
    """That sketch."""

    driver = "mpu6050-light"
    baudrate, pause_s, setup_s = 9600, 0.010, 2.5

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: D102
        if not found.sensor:
            return lines("MPU6050 status: 2"), False
        self.start(still, zero_accel=True)
        told = ("MPU6050 status: 0", "Calculating offsets, do not move MPU6050", "Done!\n")
        return lines(*told), True

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: D102
        x, y, z = self.follow(motion, dt_s)
        return lines(f"X : {x:.2f}\tY : {y:.2f}\tZ : {z:.2f}")


BOARD = running(Light)
