"""tockn/MPU6050_tockn examples/GetAngle: the banner's last line has no end."""

from __future__ import annotations

from calrig.simulator.sketch import Complementary, Found, Motion, lines
from calrig.simulator.sketch_board import running


class Tockn(Complementary):
    """That sketch."""

    driver = "tockn"
    baudrate, setup_s = 9600, 4.0

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        self.start(still)
        offsets = [f"{a} : {o:.2f}" for a, o in zip("XYZ", self._gyro_offset, strict=True)]
        told = ("", "=" * 40, "Calculating gyro offsets", "DO NOT MOVE MPU6050...", "Done!", *offsets)
        return lines(*told, "Program will start after 3 seconds") + "=" * 40, True

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: D102
        x, y, z = self.follow(motion, dt_s)
        return lines(f"angleX : {x:.2f}\tangleY : {y:.2f}\tangleZ : {z:.2f}")


BOARD = running(Tockn)
