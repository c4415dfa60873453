"""What a public Arduino sketch is, and what several of them do alike.

A sketch is set up once after a reset, then prints a record again and again. It gets vectors: the specific
force in g, the rate in °/s, the die's temperature in °C. What each prints, and when, is as recorded from the
unmodified sketch on a simulated ATmega328P; what was not recorded (the ElectronicCats sketches, a missing
sensor but for two of them) is as its source says.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

STANDARD_GRAVITY_MPS2 = 9.80665
A_CHARACTER = math.inf
"""The pause of a sketch that waits for a character."""
Vector = tuple[float, float, float]


class Motion(NamedTuple):
    """What the chip measures at one instant, in s of the board's time."""

    accel_g: Vector
    gyro_dps: Vector
    die_c: float
    at_s: float


class Found(NamedTuple):
    """What the sketch sees on its bus: a sensor or none, an MPU-6050 or a clone."""

    sensor: bool
    genuine: bool


Setup = Iterator[tuple[str, float]]
"""What a sketch prints at its start, piece by piece, each with the pause after it in s."""


class Sketch(ABC):
    """A sketch, which prints as its own source does.

    Attributes:
        driver: calrig's for what it prints.
        pause_s: from the end of a print to the next reading of the chip.
        reads: how often it reads the chip for one record, `pause_s` apart.
    """

    driver: str
    baudrate = 115200
    pause_s = 0.0
    reads = 1

    @abstractmethod
    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:
        """Yield what it prints before its first record, reading the chip as it goes."""

    def follow(self, motion: Motion) -> None:  # noqa: B027 (most print each reading)
        """Take a reading that is not printed."""

    @abstractmethod
    def record(self, motion: Motion) -> str:
        """Return what it prints each time."""


class Complementary(Sketch):
    """An angle that follows the gyro, and the accelerometer slowly."""

    def __init__(self) -> None:
        self._gyro_offset: Vector = (0.0, 0.0, 0.0)
        self._accel_offset: Vector = (0.0, 0.0, 0.0)
        self._angle = (0.0, 0.0)
        self._yaw = self._last_s = 0.0

    def begin(self, motion: Motion) -> None:
        """Start at the attitude that the accelerometer measures."""
        self._angle, self._yaw, self._last_s = self.tilt(self._less_offset(motion)), 0.0, motion.at_s

    def zero(self, still: Motion, *, accel: bool = False) -> None:
        """Take the rate at rest for none, and with `accel` the attitude for level, by subtracting vectors."""
        self._gyro_offset = still.gyro_dps
        x, y, z = still.accel_g
        self._accel_offset = (x, y, z - 1) if accel else (0.0, 0.0, 0.0)

    def tilt(self, motion: Motion) -> tuple[float, float]:
        """Roll and pitch by the accelerometer, degrees."""
        return tilt(motion)

    def follow(self, motion: Motion) -> None:
        """Take a reading into the angle."""
        self.angles(motion)

    def angles(self, motion: Motion) -> Vector:
        """Angles about x, y and z, degrees, after a reading."""
        dt_s, self._last_s = motion.at_s - self._last_s, motion.at_s
        motion = self._less_offset(motion)
        self._angle = pair(
            0.98 * (angle + rate * dt_s) + 0.02 * tilt
            for angle, rate, tilt in zip(self._angle, motion.gyro_dps[:2], self.tilt(motion), strict=True)
        )
        self._yaw += motion.gyro_dps[2] * dt_s
        return (*self._angle, self._yaw)

    def _less_offset(self, motion: Motion) -> Motion:
        ax, ay, az = (a - o for a, o in zip(motion.accel_g, self._accel_offset, strict=True))
        gx, gy, gz = (g - o for g, o in zip(motion.gyro_dps, self._gyro_offset, strict=True))
        return motion._replace(accel_g=(ax, ay, az), gyro_dps=(gx, gy, gz))


def stop(text: str) -> Setup:
    """Print and do nothing more, whatever is sent."""
    yield text, 0.0
    while True:
        yield "", A_CHARACTER


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
