"""adafruit/Adafruit_MPU6050 examples/basic_readings."""

from __future__ import annotations

from calrig.simulator.sketch import Found, Motion, Sketch, lines, si
from calrig.simulator.sketch_board import running


class Basic(Sketch):
    """That sketch."""

    driver = "adafruit-basic"
    pause_s = 0.5

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        if not (found.sensor and found.genuine):
            return lines("Adafruit MPU6050 test!", "Failed to find MPU6050 chip"), False
        ranges = ("Accelerometer range set to: +-8G", "Gyro range set to: +- 500 deg/s")
        banner = ("Adafruit MPU6050 test!", "MPU6050 Found!", *ranges, "Filter bandwidth set to: 21 Hz", "")
        return lines(*banner), True

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: ARG002, D102
        (ax, ay, az), (gx, gy, gz) = si(motion)
        return lines(
            f"Acceleration X: {ax}, Y: {ay}, Z: {az} m/s^2",
            f"Rotation X: {gx}, Y: {gy}, Z: {gz} rad/s",
            f"Temperature: {motion.die_c:.2f} degC",
            "",
        )


BOARD = running(Basic)
