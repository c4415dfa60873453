"""TKJElectronics/KalmanFilter examples/MPU6050: no banner; tries for ever to reach a sensor."""

from __future__ import annotations

from collections.abc import Callable

from calrig.simulator.sketch_board import Found, Motion, Setup, Sketch, lines, pair, running, stop, tilt


class TkjKalman(Sketch):
    """That sketch."""

    driver = "tkj-kalman"
    pause_s = 0.0066

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: D102
        while not found.sensor:
            yield lines("i2cWrite failed: 2"), 0.0003
        if not found.genuine:
            yield from stop("Error reading sensor")
        yield "", 0.102
        still = read()
        self._last_s = still.at_s
        self._gyro = self._complementary = tilt(still)
        self._kalman = tuple(_TkjFilter(angle) for angle in self._gyro)

    def record(self, motion: Motion) -> str:  # noqa: D102
        dt_s, self._last_s = motion.at_s - self._last_s, motion.at_s
        turned, rate = tilt(motion), motion.gyro_dps[:2]
        self._gyro = pair(g + r * dt_s for g, r in zip(self._gyro, rate, strict=True))
        self._complementary = pair(
            0.93 * (c + r * dt_s) + 0.07 * t
            for c, r, t in zip(self._complementary, rate, turned, strict=True)
        )
        kalman = [f.update(t, r, dt_s) for f, t, r in zip(self._kalman, turned, rate, strict=True)]
        halves = (
            "".join(f"{value:.2f}\t" for value in values)
            for values in zip(turned, self._gyro, self._complementary, kalman, strict=True)
        )
        return lines("\t".join(halves))


class _TkjFilter:
    """Lauszus' Kalman filter with its own constants: Q 0.001 and 0.003 times dt, R 0.03."""

    def __init__(self, angle_deg: float) -> None:
        self._angle, self._bias = angle_deg, 0.0
        self._p = [[0.0, 0.0], [0.0, 0.0]]

    def update(self, angle_deg: float, rate_dps: float, dt_s: float) -> float:
        p = self._p
        self._angle += dt_s * (rate_dps - self._bias)
        p[0][0] += dt_s * (dt_s * p[1][1] - p[0][1] - p[1][0] + 0.001)
        p[0][1] -= dt_s * p[1][1]
        p[1][0] -= dt_s * p[1][1]
        p[1][1] += 0.003 * dt_s
        gains = p[0][0] / (p[0][0] + 0.03), p[1][0] / (p[0][0] + 0.03)
        error, first = angle_deg - self._angle, (p[0][0], p[0][1])
        self._angle += gains[0] * error
        self._bias += gains[1] * error
        for row, gain in zip(p, gains, strict=True):
            row[0] -= gain * first[0]
            row[1] -= gain * first[1]
        return self._angle


BOARD = running(TkjKalman)
