"""Public Arduino sketches for the MPU-6050 and what each prints: all that calrig knows of one is here.

The facts are the sketches' own sources (repository and path in `source`). Serial.print gives a float two
decimals, so a line's form is known to the character; println ends it CR LF.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

STANDARD_GRAVITY_MPS2 = 9.80665
I16 = r"(0|-?[1-9]\d{0,4})"
FLOAT = r"(-?(?:0|[1-9]\d{0,4})\.\d\d)"
FROZEN_AFTER_S = 3.0
"""Two decimals repeat honestly, but not all of a line's numbers for so long."""


@dataclass(frozen=True, slots=True)
class Sketch:
    """One sketch. Numbers of a record count from 0, through all of its lines.

    Attributes:
        driver: its name in `calrig.toml`.
        source: where it is published.
        baudrate: what it sends at as published.
        pace: how fast it is, in words.
        lines: the lines of one record, each to match wholly, without its CR LF.
        bounds: of each number, how large it can be either way; a larger one shows damage.
        accel, gyro: number of the x axis (y and z follow) and what one unit is in g, in degrees per second.
        temperature: number of the die temperature in °C.
        angle: number of the elevation about x in degrees, filtered on the board.
        ranges: full scale it sets, ±g and ±°/s.
        banner: what its setup prints, found anywhere in a line: the board was reset.
        stops: what it says and then sends nothing, also without an end of line.
        remarks: what it says and goes on.
        mute: why it may send nothing at all.
        checks_chip: it goes on only with the WHO_AM_I of an MPU-6050.
        frozen_after_s: how long equal records may be honest; 0 where two in a row never are.
        zeroes_at_reset: it takes a zero anew when it starts, so that what it sends before and after a reset
            does not belong together.
        wake: what it waits for before it starts.
        starts_in_s: from reset to its first record at the latest.
    """

    driver: str
    source: str
    baudrate: int
    pace: str
    lines: tuple[re.Pattern[str], ...]
    bounds: tuple[float, ...]
    accel: tuple[int, float] | None = None
    gyro: tuple[int, float] | None = None
    temperature: int | None = None
    angle: int | None = None
    ranges: tuple[int, int] = (2, 250)
    banner: re.Pattern[str] | None = None
    stops: re.Pattern[str] | None = None
    remarks: re.Pattern[str] | None = None
    mute: str = ""
    checks_chip: bool = False
    frozen_after_s: float = FROZEN_AFTER_S
    zeroes_at_reset: bool = False
    wake: bytes = b""
    starts_in_s: float = 6.0


def _form(*lines: str) -> tuple[re.Pattern[str], ...]:
    """Patterns of lines in which `#` stands for an i16 and `%` for a float."""
    return tuple(
        re.compile(re.escape(line).replace(r"\#", I16).replace("%", FLOAT), re.ASCII) for line in lines
    )


_RAW_BANNER = re.compile(
    r"Initializing (I2C devices|MPU)\.\.\.|Testing (device connections|MPU6050 connection)\.\.\."
    r"|MPU6050 connection successful|Updating internal sensor offsets"
)
_CONNECTION_FAILED = re.compile(r"MPU6050 connection failed")

I2CDEV_RAW = Sketch(
    driver="i2cdev-raw",
    source="jrowberg/i2cdevlib or ElectronicCats/mpu6050, MPU6050_raw",
    baudrate=38400,
    pace="10 lines a second, ElectronicCats' about 110",
    lines=_form("a/g:" + "\t#" * 6),
    bounds=(32768,) * 6,
    accel=(0, 1 / 16384),
    gyro=(3, 1 / 131),
    banner=_RAW_BANNER,
    remarks=_CONNECTION_FAILED,
    mute="ElectronicCats' sketch stops where WHO_AM_I is not an MPU-6050's: check the sensor's wires",
    frozen_after_s=0.0,
)

TKJ_KALMAN = Sketch(
    driver="tkj-kalman",
    source="TKJElectronics/KalmanFilter, examples/MPU6050",
    baudrate=115200,
    pace="about 150 lines a second",
    lines=_form("%\t%\t%\t%\t\t%\t%\t%\t%\t"),
    bounds=(180, 400, 400, 400, 180, 400, 400, 400),
    angle=3,
    stops=re.compile(r"Error reading sensor"),
    mute="this sketch waits in silence for a sensor that does not answer: check the sensor's wires",
    checks_chip=True,
)

ADAFRUIT_PLOTTER = Sketch(
    driver="adafruit-plotter",
    source="adafruit/Adafruit_MPU6050, examples/plotter",
    baudrate=115200,
    pace="60 to 90 lines a second",
    lines=_form("AccelX:%,AccelY:%,AccelZ:%, GyroX:%,GyroY:%,GyroZ:%"),
    bounds=(157,) * 3 + (4.37,) * 3,
    accel=(0, 1 / STANDARD_GRAVITY_MPS2),
    gyro=(3, math.degrees(1)),
    ranges=(16, 250),
    banner=re.compile(r"^$"),
    stops=re.compile(r"Failed to find MPU6050 chip"),
    checks_chip=True,
)

ADAFRUIT_BASIC = Sketch(
    driver="adafruit-basic",
    source="adafruit/Adafruit_MPU6050, examples/basic_readings",
    baudrate=115200,
    pace="2 records a second",
    lines=_form(
        "Acceleration X: %, Y: %, Z: % m/s^2", "Rotation X: %, Y: %, Z: % rad/s", "Temperature: % degC", ""
    ),
    bounds=(78.6,) * 3 + (8.74,) * 3 + (133,),
    accel=(0, 1 / STANDARD_GRAVITY_MPS2),
    gyro=(3, math.degrees(1)),
    temperature=6,
    ranges=(8, 500),
    banner=re.compile(
        r"Adafruit MPU6050 test!|MPU6050 Found!|(Accelerometer|Gyro) range set to: |Filter bandwidth set to: "
    ),
    stops=re.compile(r"Failed to find MPU6050 chip"),
    checks_chip=True,
)

MPU6050_LIGHT = Sketch(
    driver="mpu6050-light",
    source="rfetick/MPU6050_light, examples/GetAngle",
    baudrate=9600,
    pace="about 27 lines a second: more do not pass at 9600 baud",
    lines=_form("X : %\tY : %\tZ : %"),
    bounds=(400, 400, 99999),
    angle=0,
    ranges=(2, 500),
    banner=re.compile(r"MPU6050 status: 0|Calculating offsets, do not move MPU6050|^Done!$"),
    stops=re.compile(r"MPU6050 status: [1-9]\d*"),
    zeroes_at_reset=True,
    starts_in_s=8.0,
)

TOCKN = Sketch(
    driver="tockn",
    source="tockn/MPU6050_tockn, examples/GetAngle",
    baudrate=9600,
    pace="about 20 lines a second: more do not pass at 9600 baud",
    lines=_form("angleX : %\tangleY : %\tangleZ : %"),
    bounds=(400, 400, 99999),
    angle=0,
    ranges=(2, 500),
    banner=re.compile(
        r"={40}|[Cc]alculat(e|ing) gyro offsets|DO NOT MOVE (A )?MPU6050|^Done!+$"
        r"|Program will start after 3 seconds"
    ),
    zeroes_at_reset=True,
    starts_in_s=18.0,
)

DMP_YPR = Sketch(
    driver="dmp-ypr",
    source="jrowberg/i2cdevlib or ElectronicCats/mpu6050, MPU6050_DMP6",
    baudrate=115200,
    pace="100 lines a second",
    lines=_form("ypr\t%\t%\t%"),
    bounds=(180, 180, 180),
    angle=2,
    ranges=(2, 2000),
    banner=re.compile(
        r"Initializing (I2C devices|DMP)\.\.\.|Testing (device connections|MPU6050 connection)\.\.\."
        r"|MPU6050 connection successful|Send any character to begin|Enabling (DMP|interrupt detection)"
        r"|DMP ready! Waiting for first interrupt|These are the Active offsets"
    ),
    stops=re.compile(r"DMP Initialization failed \(code \d+\)"),
    remarks=re.compile(r"MPU6050 connection failed|FIFO overflow!"),
    mute="ElectronicCats' sketch stops where WHO_AM_I is not an MPU-6050's: check the sensor's wires",
    zeroes_at_reset=True,
    wake=b"s",
    starts_in_s=15.0,
)

SKETCHES = (I2CDEV_RAW, TKJ_KALMAN, ADAFRUIT_PLOTTER, ADAFRUIT_BASIC, MPU6050_LIGHT, TOCKN, DMP_YPR)
