"""jrowberg/i2cdevlib MPU6050_DMP6: begins once a character has come; the chip itself filters."""

from __future__ import annotations

from calrig.simulator.sketch import Complementary, Found, Motion, lines
from calrig.simulator.sketch_board import running


class Dmp(Complementary):
    """That sketch."""

    driver = "dmp-ypr"
    pause_s, setup_s = 0.010, 0.5

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: D102
        self.start(still)
        if not found.sensor:
            return lines("Initializing DMP...", "DMP Initialization failed (code 1)"), False
        told = ("Initializing DMP...", "Enabling DMP...")
        waiting = "Enabling interrupt detection (Arduino external interrupt 0)..."
        return lines(*told, waiting, "DMP ready! Waiting for first interrupt..."), True

    def prompt(self, found: Found) -> str:  # noqa: D102
        outcome = "successful" if found.sensor and found.genuine else "failed"
        told = ("Initializing I2C devices...", "Testing device connections...")
        question = "\nSend any character to begin DMP programming and demo: "
        return lines(*told, f"MPU6050 connection {outcome}", question)

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: D102
        roll, pitch, yaw = self.follow(motion, dt_s)
        return lines(f"ypr\t{yaw:.2f}\t{pitch:.2f}\t{roll:.2f}")


BOARD = running(Dmp)
