"""adafruit/Adafruit_MPU6050 examples/plotter."""

from __future__ import annotations

from calrig.simulator.sketch import Found, Motion, Sketch, lines, si
from calrig.simulator.sketch_board import running


class Plotter(Sketch):
    """That sketch."""

    driver = "adafruit-plotter"
    pause_s = 0.010

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        good = found.sensor and found.genuine
        return lines("" if good else "Failed to find MPU6050 chip"), good

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: ARG002, D102
        accel, gyro = si(motion)
        values = (
            (f"Accel{a}:{v}" for a, v in zip("XYZ", accel, strict=True)),
            (f"Gyro{a}:{v}" for a, v in zip("XYZ", gyro, strict=True)),
        )
        return lines(", ".join(",".join(three) for three in values))


BOARD = running(Plotter)
