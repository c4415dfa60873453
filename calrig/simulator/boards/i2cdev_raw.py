"""jrowberg/i2cdevlib MPU6050_raw: goes on with whatever it finds."""

from __future__ import annotations

from collections.abc import Callable

from calrig.simulator.sketch_board import Found, Motion, Setup, Sketch, lines, running


class Raw(Sketch):
    """That sketch."""

    driver = "i2cdev-raw"
    baudrate, pause_s = 38400, 0.1012

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: ARG002, D102
        outcome = "successful" if found.sensor and found.genuine else "failed"
        told = ("Initializing I2C devices...", "Testing device connections...")
        yield lines(*told, f"MPU6050 connection {outcome}"), 0.0

    def record(self, motion: Motion) -> str:  # noqa: D102
        accel = [_i16(16384 * a) for a in motion.accel_g]
        gyro = [_i16(131 * g) for g in motion.gyro_dps]
        return lines("\t".join(["a/g:", *map(str, accel + gyro)]))


BOARD = running(Raw)


def _i16(counts: float) -> int:
    return max(-32768, min(32767, round(counts)))
