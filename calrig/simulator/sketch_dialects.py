"""What public Arduino sketches print about an MPU-6050, each as its own source does (sketches.md).

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
    """A sketch. `pause_s` lies between two records, `setup_s` is what its set-up takes."""

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


class Raw(Sketch):
    """jrowberg/i2cdevlib MPU6050_raw: goes on with whatever it finds."""

    baudrate, pause_s = 38400, 0.1

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        outcome = "successful" if found.sensor and found.genuine else "failed"
        lines = ("Initializing I2C devices...", "Testing device connections...")
        return _lines(*lines, f"MPU6050 connection {outcome}"), True

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: ARG002, D102
        accel = [_i16(16384 * a) for a in motion.accel_g]
        gyro = [_i16(131 * g) for g in motion.gyro_dps]
        return _lines("\t".join(["a/g:", *map(str, accel + gyro)]))


class FastRaw(Raw):
    """ElectronicCats/mpu6050 MPU6050_raw: without a pause, and it stops at a clone."""

    pause_s = 0.0

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        lines = _lines("Initializing MPU...", "Testing MPU6050 connection...")
        if not (found.sensor and found.genuine):
            return lines + _lines("MPU6050 connection failed"), False
        offsets = _lines("Updating internal sensor offsets...\n") + "\t0\t0\t0\t0\t0\t0\n"
        return lines + _lines("MPU6050 connection successful") + offsets, True


class TkjKalman(Sketch):
    """TKJElectronics/KalmanFilter examples/MPU6050: waits for ever for a sensor that is not there."""

    pause_s = 0.002

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: D102
        self._gyro = self._complementary = _tilt(still)
        self._kalman = tuple(_TkjFilter(angle) for angle in self._gyro)
        clone = found.sensor and not found.genuine
        return "Error reading sensor" if clone else "", found.sensor and found.genuine

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: D102
        tilt, rate = _tilt(motion), motion.gyro_dps[:2]
        self._gyro = _pair(g + r * dt_s for g, r in zip(self._gyro, rate, strict=True))
        self._complementary = _pair(
            0.93 * (c + r * dt_s) + 0.07 * t for c, r, t in zip(self._complementary, rate, tilt, strict=True)
        )
        kalman = [f.update(t, r, dt_s) for f, t, r in zip(self._kalman, tilt, rate, strict=True)]
        halves = (
            "".join(f"{value:.2f}\t" for value in values)
            for values in zip(tilt, self._gyro, self._complementary, kalman, strict=True)
        )
        return _lines("\t".join(halves))


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


class Plotter(Sketch):
    """adafruit/Adafruit_MPU6050 examples/plotter."""

    pause_s = 0.010

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        good = found.sensor and found.genuine
        return _lines("" if good else "Failed to find MPU6050 chip"), good

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: ARG002, D102
        accel, gyro = _si(motion)
        values = (
            (f"Accel{a}:{v}" for a, v in zip("XYZ", accel, strict=True)),
            (f"Gyro{a}:{v}" for a, v in zip("XYZ", gyro, strict=True)),
        )
        return _lines(", ".join(",".join(three) for three in values))


class Basic(Sketch):
    """adafruit/Adafruit_MPU6050 examples/basic_readings."""

    pause_s = 0.5

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        if not (found.sensor and found.genuine):
            return _lines("Adafruit MPU6050 test!", "Failed to find MPU6050 chip"), False
        ranges = ("Accelerometer range set to: +-8G", "Gyro range set to: +- 500 deg/s")
        banner = ("Adafruit MPU6050 test!", "MPU6050 Found!", *ranges, "Filter bandwidth set to: 21 Hz", "")
        return _lines(*banner), True

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: ARG002, D102
        (ax, ay, az), (gx, gy, gz) = _si(motion)
        return _lines(
            f"Acceleration X: {ax}, Y: {ay}, Z: {az} m/s^2",
            f"Rotation X: {gx}, Y: {gy}, Z: {gz} rad/s",
            f"Temperature: {motion.die_c:.2f} degC",
            "",
        )


class _Complementary(Sketch):
    """An angle that follows the gyro, and the accelerometer slowly."""

    def __init__(self) -> None:
        self._gyro_offset: Vector = (0.0, 0.0, 0.0)
        self._accel_offset: Vector = (0.0, 0.0, 0.0)
        self._angle = (0.0, 0.0)
        self._yaw = 0.0

    def start(self, still: Motion, *, zero_accel: bool = False) -> None:
        self._gyro_offset = still.gyro_dps
        x, y, z = still.accel_g
        self._accel_offset = (x, y, z - 1) if zero_accel else (0.0, 0.0, 0.0)
        self._angle, self._yaw = _tilt(self._less_offset(still)), 0.0

    def follow(self, motion: Motion, dt_s: float) -> tuple[float, float, float]:
        motion = self._less_offset(motion)
        self._angle = _pair(
            0.98 * (angle + rate * dt_s) + 0.02 * tilt
            for angle, rate, tilt in zip(self._angle, motion.gyro_dps[:2], _tilt(motion), strict=True)
        )
        self._yaw += motion.gyro_dps[2] * dt_s
        return (*self._angle, self._yaw)

    def _less_offset(self, motion: Motion) -> Motion:
        ax, ay, az = (a - o for a, o in zip(motion.accel_g, self._accel_offset, strict=True))
        gx, gy, gz = (g - o for g, o in zip(motion.gyro_dps, self._gyro_offset, strict=True))
        return Motion((ax, ay, az), (gx, gy, gz), motion.die_c)


class Light(_Complementary):
    """rfetick/MPU6050_light examples/GetAngle: takes where it starts for level, asks no WHO_AM_I."""

    baudrate, pause_s, setup_s = 9600, 0.010, 2.5

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: D102
        if not found.sensor:
            return _lines("MPU6050 status: 2"), False
        self.start(still, zero_accel=True)
        lines = ("MPU6050 status: 0", "Calculating offsets, do not move MPU6050", "Done!\n")
        return _lines(*lines), True

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: D102
        x, y, z = self.follow(motion, dt_s)
        return _lines(f"X : {x:.2f}\tY : {y:.2f}\tZ : {z:.2f}")


class Tockn(_Complementary):
    """tockn/MPU6050_tockn examples/GetAngle: the banner's last line has no end."""

    baudrate, setup_s = 9600, 4.0

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: ARG002, D102
        self.start(still)
        offsets = [f"{a} : {o:.2f}" for a, o in zip("XYZ", self._gyro_offset, strict=True)]
        lines = ("", "=" * 40, "Calculating gyro offsets", "DO NOT MOVE MPU6050...", "Done!", *offsets)
        return _lines(*lines, "Program will start after 3 seconds") + "=" * 40, True

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: D102
        x, y, z = self.follow(motion, dt_s)
        return _lines(f"angleX : {x:.2f}\tangleY : {y:.2f}\tangleZ : {z:.2f}")


class Dmp(_Complementary):
    """jrowberg/i2cdevlib MPU6050_DMP6: begins once a character has come; the chip itself filters."""

    pause_s, setup_s = 0.010, 0.5

    def setup(self, found: Found, still: Motion) -> tuple[str, bool]:  # noqa: D102
        self.start(still)
        if not found.sensor:
            return _lines("Initializing DMP...", "DMP Initialization failed (code 1)"), False
        lines = ("Initializing DMP...", "Enabling DMP...")
        waiting = "Enabling interrupt detection (Arduino external interrupt 0)..."
        return _lines(*lines, waiting, "DMP ready! Waiting for first interrupt..."), True

    def prompt(self, found: Found) -> str:  # noqa: D102
        outcome = "successful" if found.sensor and found.genuine else "failed"
        lines = ("Initializing I2C devices...", "Testing device connections...")
        question = "\nSend any character to begin DMP programming and demo: "
        return _lines(*lines, f"MPU6050 connection {outcome}", question)

    def record(self, motion: Motion, dt_s: float) -> str:  # noqa: D102
        roll, pitch, yaw = self.follow(motion, dt_s)
        return _lines(f"ypr\t{yaw:.2f}\t{pitch:.2f}\t{roll:.2f}")


SKETCHES: dict[str, type[Sketch]] = {
    "i2cdev-raw": Raw,
    "i2cdev-raw-fast": FastRaw,
    "tkj-kalman": TkjKalman,
    "adafruit-plotter": Plotter,
    "adafruit-basic": Basic,
    "mpu6050-light": Light,
    "tockn": Tockn,
    "dmp-ypr": Dmp,
}


def _lines(*texts: str) -> str:
    return "".join(f"{text}\r\n" for text in texts)


def _i16(counts: float) -> int:
    return max(-32768, min(32767, round(counts)))


def _tilt(motion: Motion) -> tuple[float, float]:
    """Roll about x and pitch about y by the accelerometer (Freescale AN3461, equations 25, 26), degrees."""
    x, y, z = motion.accel_g
    return math.degrees(math.atan2(y, z)), math.degrees(math.atan2(-x, math.hypot(y, z)))


def _si(motion: Motion) -> tuple[list[str], list[str]]:
    """Adafruit's units, m/s² and rad/s, as printed."""
    accel = [f"{a * STANDARD_GRAVITY_MPS2:.2f}" for a in motion.accel_g]
    return accel, [f"{math.radians(g):.2f}" for g in motion.gyro_dps]


def _pair(values: Iterable[float]) -> tuple[float, float]:
    first, second = values
    return first, second
