"""What a public Arduino sketch is, and what several of them do alike.

A sketch is set up once after a reset, then prints a record again and again. It gets vectors: the specific
force in g, the rate in °/s, the die's temperature in °C.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import NamedTuple

STANDARD_GRAVITY_MPS2 = 9.80665
Vector = tuple[float, float, float]


class Motion(NamedTuple):
    """What the chip measures at one instant."""

    accel_g: Vector
    gyro_dps: Vector
    die_c: float


class Found(NamedTuple):
    """What the sketch sees on its bus: a sensor or none, an MPU-6050 or a clone."""

    sensor: bool
    genuine: bool


class Sketch(ABC):
    """A sketch, which prints as its own source does.

    `driver` is calrig's for what it prints, `pause_s` lies between two records, `setup_s` is what its set-up
    takes.
    """

    driver: str
    baudrate = 115200
    pause_s = 0.0
    setup_s = 0.1

    def prompt(self, found: Found) -> str:  # noqa: ARG002
        """What it prints before it waits for a character; nothing where it does not wait."""
        return ""

    @abstractmethod
    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:
        """What it prints at its start, and whether it goes on from there."""

    @abstractmethod
    def record(self, motion: Motion, dt_s: float) -> str:
        """What it prints each time."""


class Complementary(Sketch):
    """An angle that follows the gyro, and the accelerometer slowly."""

    def __init__(self) -> None:
        self._gyro_offset: Vector = (0.0, 0.0, 0.0)
        self._accel_offset: Vector = (0.0, 0.0, 0.0)
        self._angle = (0.0, 0.0)
        self._yaw = 0.0

    def start(self, still: Motion, *, zero_accel: bool = False) -> None:
        """Takes the rate where it stands for none, and with `zero_accel` its attitude for level."""
        self._gyro_offset = still.gyro_dps
        x, y, z = still.accel_g
        self._accel_offset = (x, y, z - 1) if zero_accel else (0.0, 0.0, 0.0)
        self._angle, self._yaw = tilt(self._less_offset(still)), 0.0

    def follow(self, motion: Motion, dt_s: float) -> tuple[float, float, float]:
        """Angles about x, y and z, degrees, after a step."""
        motion = self._less_offset(motion)
        self._angle = pair(
            0.98 * (angle + rate * dt_s) + 0.02 * tilt
            for angle, rate, tilt in zip(self._angle, motion.gyro_dps[:2], tilt(motion), strict=True)
        )
        self._yaw += motion.gyro_dps[2] * dt_s
        return (*self._angle, self._yaw)

    def _less_offset(self, motion: Motion) -> Motion:
        ax, ay, az = (a - o for a, o in zip(motion.accel_g, self._accel_offset, strict=True))
        gx, gy, gz = (g - o for g, o in zip(motion.gyro_dps, self._gyro_offset, strict=True))
        return Motion((ax, ay, az), (gx, gy, gz), motion.die_c)


def lines(*texts: str) -> str:
    """Lines as an Arduino ends them."""
    return "".join(f"{text}\r\n" for text in texts)


def tilt(motion: Motion) -> tuple[float, float]:
    """Roll about x and pitch about y by the accelerometer (Freescale AN3461, equations 25, 26), degrees."""
    x, y, z = motion.accel_g
    return math.degrees(math.atan2(y, z)), math.degrees(math.atan2(-x, math.hypot(y, z)))


def pair(values: Iterable[float]) -> tuple[float, float]:
    """Two values, of x and y."""
    first, second = values
    return first, second


def si(motion: Motion) -> tuple[list[str], list[str]]:
    """Adafruit's units, m/s² and rad/s, as printed."""
    accel = [f"{a * STANDARD_GRAVITY_MPS2:.2f}" for a in motion.accel_g]
    return accel, [f"{math.radians(g):.2f}" for g in motion.gyro_dps]
