"""jrowberg/i2cdevlib MPU6050_DMP6: begins once a character has come; the chip itself filters.

It writes the accelerometer's offsets into the chip at its start, so that it is level as it stands then.
"""

from __future__ import annotations

from collections.abc import Callable

from calrig.simulator.sketch_board import (
    A_CHARACTER,
    Complementary,
    Found,
    Motion,
    Setup,
    lines,
    running,
    stop,
)

CALIBRATION = ">*......>......"
"""A mark a step: of the accelerometer, then of the gyro; `*` where it was still far off."""
CALIBRATION_S = 1.97
OFFSET_PER_G = 2048.0
OFFSET_PER_DPS = 32.8


class Dmp(Complementary):
    """That sketch."""

    driver = "dmp-ypr"
    pause_s = 0.010

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: D102
        outcome = "successful" if found.sensor and found.genuine else "failed"
        told = ("Initializing I2C devices...", "Testing device connections...")
        question = "\nSend any character to begin DMP programming and demo: "
        yield lines(*told, f"MPU6050 connection {outcome}", question), A_CHARACTER
        yield lines("Initializing DMP..."), 0.19
        if not found.sensor:
            yield from stop(lines("DMP Initialization failed (code 1)"))
        for mark in CALIBRATION:
            yield mark, CALIBRATION_S / len(CALIBRATION)
        still = read()
        self.zero(still, accel=True)
        self.begin(still)
        (x, y, z), rates = still.accel_g, still.gyro_dps
        offsets = [-OFFSET_PER_G * a for a in (x, y, z - 1)] + [-OFFSET_PER_DPS * g for g in rates]
        yield ",\t".join(f"{round(offset):.5f}" for offset in offsets) + "\n\n", 0.0
        waiting = "Enabling interrupt detection (Arduino external interrupt 0)..."
        yield lines("Enabling DMP...", waiting, "DMP ready! Waiting for first interrupt..."), 0.0

    def record(self, motion: Motion) -> str:  # noqa: D102
        roll, pitch, yaw = self.angles(motion)
        return lines(f"ypr\t{yaw:.2f}\t{pitch:.2f}\t{roll:.2f}")


BOARD = running(Dmp)
