"""adafruit/Adafruit_MPU6050 examples/plotter."""

from __future__ import annotations

from collections.abc import Callable

from calrig.simulator.sketch_board import Found, Motion, Setup, Sketch, lines, running, si, stop


class Plotter(Sketch):
    """That sketch."""

    driver = "adafruit-plotter"
    pause_s = 0.0122

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: ARG002, D102
        good = found.sensor and found.genuine
        yield "", 0.305 if good else 0.05
        if not good:
            yield from stop(lines("Failed to find MPU6050 chip"))
        yield lines(""), 0.1

    def record(self, motion: Motion) -> str:  # noqa: D102
        accel, gyro = si(motion)
        values = (
            (f"Accel{a}:{v}" for a, v in zip("XYZ", accel, strict=True)),
            (f"Gyro{a}:{v}" for a, v in zip("XYZ", gyro, strict=True)),
        )
        return lines(", ".join(",".join(three) for three in values))


BOARD = running(Plotter)
