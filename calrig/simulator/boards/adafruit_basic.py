"""adafruit/Adafruit_MPU6050 examples/basic_readings."""

from __future__ import annotations

from collections.abc import Callable

from calrig.simulator.sketch_board import Found, Motion, Setup, Sketch, lines, running, si, stop


class Basic(Sketch):
    """That sketch."""

    driver = "adafruit-basic"
    pause_s = 0.501

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: ARG002, D102
        good = found.sensor and found.genuine
        yield lines("Adafruit MPU6050 test!"), 0.30 if good else 0.05
        if not good:
            yield from stop(lines("Failed to find MPU6050 chip"))
        ranges = ("Accelerometer range set to: +-8G", "Gyro range set to: +- 500 deg/s")
        yield lines("MPU6050 Found!", *ranges, "Filter bandwidth set to: 21 Hz", ""), 0.1

    def record(self, motion: Motion) -> str:  # noqa: D102
        (ax, ay, az), (gx, gy, gz) = si(motion)
        return lines(
            f"Acceleration X: {ax}, Y: {ay}, Z: {az} m/s^2",
            f"Rotation X: {gx}, Y: {gy}, Z: {gz} rad/s",
            f"Temperature: {motion.die_c:.2f} degC",
            "",
        )


BOARD = running(Basic)
