"""Public Arduino sketches that print text, one class each.

A sketch is set up once after a reset, then prints a record again and again. It gets vectors: the specific
force in g, the rate in °/s, the die's temperature in °C. What each sketch prints, and when, was recorded from
the unmodified sketch on a simulated ATmega328P. The ElectronicCats sketches, and a missing sensor except for
two of them, follow the sketch's source.
"""

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


class Raw(Sketch):
    """jrowberg/i2cdevlib MPU6050_raw: goes on with whatever it finds."""

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


def _i16(counts: float) -> int:
    return max(-32768, min(32767, round(counts)))


class FastRaw(Raw):
    """ElectronicCats/mpu6050 MPU6050_raw: without a pause, and it stops at a clone."""

    pause_s = 0.009

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: ARG002, D102
        yield lines("Initializing MPU...", "Testing MPU6050 connection..."), 0.0
        if not (found.sensor and found.genuine):
            yield from stop(lines("MPU6050 connection failed"))
        offsets = lines("Updating internal sensor offsets...\n") + "\t0\t0\t0\t0\t0\t0\n"
        yield lines("MPU6050 connection successful") + offsets, 0.0


class TkjKalman(Sketch):
    """TKJElectronics/KalmanFilter examples/MPU6050: no banner; tries for ever to reach a sensor."""

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


class Plotter(Sketch):
    """adafruit/Adafruit_MPU6050 examples/plotter."""

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


class Basic(Sketch):
    """adafruit/Adafruit_MPU6050 examples/basic_readings."""

    driver = "adafruit-basic"
    pause_s = 0.501

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: ARG002, D102
        good = found.sensor and found.genuine
        yield lines("Adafruit MPU6050 test!"), 0.30 if good else 0.05
        if not good:
            yield from stop(lines("Failed to find MPU6050 chip"))
        ranges = ("Accelerometer range set to: +-8G", "Gyro range set to: +- 500 deg/s")
        yield lines("MPU6050 Found!", *ranges, "Filter bandwidth set to: 21 Hz", ""), 0.1

    def record(self, motion: Motion) -> str:  # noqa: D102
        (ax, ay, az), (gx, gy, gz) = si(motion)
        return lines(
            f"Acceleration X: {ax}, Y: {ay}, Z: {az} m/s^2",
            f"Rotation X: {gx}, Y: {gy}, Z: {gz} rad/s",
            f"Temperature: {motion.die_c:.2f} degC",
            "",
        )


class Light(Complementary):
    """rfetick/MPU6050_light examples/GetAngle: takes where it starts for level, asks no WHO_AM_I.

    It reads and filters while its print is due in 10 ms, so that its filter is a fast one.
    """

    driver = "mpu6050-light"
    baudrate, pause_s, reads = 9600, 0.0014, 8

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: D102
        if not found.sensor:
            yield from stop(lines("MPU6050 status: 2"))
        self.begin(read())
        yield lines("MPU6050 status: 0", "Calculating offsets, do not move MPU6050"), 1.85
        self.zero(read(), accel=True)
        yield "Done!\n\r\n", 0.0

    def tilt(self, motion: Motion) -> tuple[float, float]:  # noqa: D102
        x, y, z = motion.accel_g
        roll = math.atan2(y, math.copysign(math.hypot(x, z), z))
        return math.degrees(roll), math.degrees(-math.atan2(x, math.hypot(y, z)))

    def record(self, motion: Motion) -> str:  # noqa: D102
        x, y, z = self.angles(motion)
        return lines(f"X : {x:.2f}\tY : {y:.2f}\tZ : {z:.2f}")


class Tockn(Complementary):
    """tockn/MPU6050_tockn examples/GetAngle: takes the gyro's zero at its start, its level from gravity.

    Its banner's last line has no end.
    """

    driver = "tockn"
    baudrate, pause_s = 9600, 0.002

    def setup(self, found: Found, read: Callable[[], Motion]) -> Setup:  # noqa: ARG002, D102
        self.begin(read())
        yield "", 1.0
        yield lines("", "=" * 40, "Calculating gyro offsets") + "DO NOT MOVE MPU6050.", 0.323
        yield ".", 0.323
        yield ".", 0.323
        self.zero(read())
        offsets = [f"{a} : {o:.2f}" for a, o in zip("XYZ", self._gyro_offset, strict=True)]
        yield lines("", "Done!", *offsets, "Program will start after 3 seconds") + "=" * 40, 3.0

    def tilt(self, motion: Motion) -> tuple[float, float]:  # noqa: D102
        x, y, z = motion.accel_g
        roll, pitch = math.atan2(y, math.hypot(x, z)), -math.atan2(x, math.hypot(y, z))
        return math.degrees(roll), math.degrees(pitch)

    def record(self, motion: Motion) -> str:  # noqa: D102
        x, y, z = self.angles(motion)
        return lines(f"angleX : {x:.2f}\tangleY : {y:.2f}\tangleZ : {z:.2f}")


CALIBRATION = ">*......>......"
"""A mark a step: of the accelerometer, then of the gyro; `*` where it was still far off."""
CALIBRATION_S = 1.97
OFFSET_PER_G = 2048.0
OFFSET_PER_DPS = 32.8


class Dmp(Complementary):
    """jrowberg/i2cdevlib MPU6050_DMP6: begins once a character has come; the chip itself filters.

    It writes the accelerometer's offsets into the chip at its start, so that it is level as it stands then.
    """

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


SKETCHES: dict[str, type[Sketch]] = {
    "adafruit-basic": Basic,
    "adafruit-plotter": Plotter,
    "dmp-ypr": Dmp,
    "i2cdev-raw": Raw,
    "i2cdev-raw-fast": FastRaw,
    "mpu6050-light": Light,
    "tkj-kalman": TkjKalman,
    "tockn": Tockn,
}
"""By the name of a rig's `sketch`."""
