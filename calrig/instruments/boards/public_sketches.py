"""The public sketches that calrig reads: the facts of each; `sketch` says what they mean."""

import math
import re

from calrig.instruments.boards.sketch import STANDARD_GRAVITY_MPS2, Sketch, line_forms

SKETCHES = (
    # MPU6050_raw of i2cdevlib and of ElectronicCats: registers, without temperature.
    Sketch(
        driver="i2cdev-raw",
        source="jrowberg/i2cdevlib or ElectronicCats/mpu6050, MPU6050_raw",
        baudrate=38400,
        pace="10 lines a second, ElectronicCats' about 110",
        lines=line_forms("a/g:" + "\t#" * 6),
        bounds=(32768,) * 6,
        accel=(0, 1 / 16384),
        gyro=(3, 1 / 131),
        banner=re.compile(
            r"Initializing (I2C devices|MPU)\.\.\.|Testing (device connections|MPU6050 connection)\.\.\."
            r"|MPU6050 connection successful|Updating internal sensor offsets"
        ),
        remarks=re.compile(r"MPU6050 connection failed"),
        mute="ElectronicCats' sketch stops where WHO_AM_I is not an MPU-6050's: check the sensor's wires",
        frozen_after_s=0.0,
    ),
    # MPU6050_DMP6 of i2cdevlib and of ElectronicCats: yaw, pitch and roll of the chip's own processor.
    Sketch(
        driver="dmp-ypr",
        source="jrowberg/i2cdevlib or ElectronicCats/mpu6050, MPU6050_DMP6",
        baudrate=115200,
        pace="100 lines a second",
        lines=line_forms("ypr\t%\t%\t%"),
        bounds=(180, 180, 180),
        angle=2,
        ranges=(2, 2000),
        banner=re.compile(
            r"Initializing (I2C devices|DMP)\.\.\.|Testing (device connections|MPU6050 connection)\.\.\."
            r"|MPU6050 connection successful|Send any character to begin|Enabling (DMP|interrupt detection)"
            r"|^>[*.]*>[*.]*(-?\d+\.0{5}(,\t)?){6}$|DMP ready! Waiting for first interrupt"
            r"|These are the Active offsets"
        ),
        stops=re.compile(r"DMP Initialization failed \(code \d+\)"),
        remarks=re.compile(r"MPU6050 connection failed|FIFO overflow!"),
        mute="ElectronicCats' sketch stops where WHO_AM_I is not an MPU-6050's: check the sensor's wires",
        zeroes_at_reset=True,
        wake=b"s",
        starts_in_s=15.0,
    ),
    # TKJElectronics' Kalman filter example: an angle filtered on the board.
    Sketch(
        driver="tkj-kalman",
        source="TKJElectronics/KalmanFilter, examples/MPU6050",
        baudrate=115200,
        pace="about 150 lines a second",
        lines=line_forms("%\t%\t%\t%\t\t%\t%\t%\t%\t"),
        bounds=(180, 400, 400, 400, 180, 400, 400, 400),
        angle=3,
        stops=re.compile(r"Error reading sensor"),
        remarks=re.compile(r"i2c(Read|Write) (failed: \d|timeout)"),
        mute="this sketch falls silent where the sensor's bus hangs: check the sensor's wires",
        is_mute_at_reset=True,
        settles_s=2.0,
        checks_chip=True,
    ),
    # GetAngle of MPU6050_light: an angle filtered on the board, its zero where it stood at its start.
    Sketch(
        driver="mpu6050-light",
        source="rfetick/MPU6050_light, examples/GetAngle",
        baudrate=9600,
        pace="about 33 lines a second: more do not pass at 9600 baud",
        lines=line_forms("X : %\tY : %\tZ : %"),
        bounds=(400, 400, 99999),
        angle=0,
        ranges=(2, 500),
        banner=re.compile(r"MPU6050 status: 0|Calculating offsets, do not move MPU6050|^Done!$"),
        stops=re.compile(r"MPU6050 status: [1-9]\d*"),
        zeroes_at_reset=True,
        starts_in_s=8.0,
        heard_within_s=0.6,
    ),
    # GetAngle of MPU6050_tockn: an angle filtered on the board, which takes the gyro's zero at its start.
    Sketch(
        driver="tockn",
        source="tockn/MPU6050_tockn, examples/GetAngle",
        baudrate=9600,
        pace="about 22 lines a second: more do not pass at 9600 baud",
        lines=line_forms("angleX : %\tangleY : %\tangleZ : %"),
        bounds=(400, 400, 99999),
        angle=0,
        ranges=(2, 500),
        banner=re.compile(
            r"={40}|[Cc]alculat(e|ing) gyro offsets|DO NOT MOVE (A )?MPU6050|^Done!+$"
            r"|Program will start after 3 seconds"
        ),
        zeroes_at_reset=True,
        starts_in_s=18.0,
        heard_within_s=0.6,
    ),
    # Adafruit's plotter example: m/s² and rad/s in one line.
    Sketch(
        driver="adafruit-plotter",
        source="adafruit/Adafruit_MPU6050, examples/plotter",
        baudrate=115200,
        pace="60 to 90 lines a second",
        lines=line_forms("AccelX:%,AccelY:%,AccelZ:%, GyroX:%,GyroY:%,GyroZ:%"),
        bounds=(157,) * 3 + (4.37,) * 3,
        accel=(0, 1 / STANDARD_GRAVITY_MPS2),
        gyro=(3, math.degrees(1)),
        ranges=(16, 250),
        banner=re.compile(r"^$"),  # which only ends the line that a reset cut short
        is_mute_at_reset=True,
        stops=re.compile(r"Failed to find MPU6050 chip"),
        checks_chip=True,
    ),
    # Adafruit's basic_readings example: a record of four lines, with temperature.
    Sketch(
        driver="adafruit-basic",
        source="adafruit/Adafruit_MPU6050, examples/basic_readings",
        baudrate=115200,
        pace="2 records a second",
        lines=line_forms(
            "Acceleration X: %, Y: %, Z: % m/s^2",
            "Rotation X: %, Y: %, Z: % rad/s",
            "Temperature: % degC",
            "",
        ),
        bounds=(78.6,) * 3 + (8.74,) * 3 + (133,),
        accel=(0, 1 / STANDARD_GRAVITY_MPS2),
        gyro=(3, math.degrees(1)),
        temperature=6,
        ranges=(8, 500),
        banner=re.compile(
            r"Adafruit MPU6050 test!|MPU6050 Found!|(Accelerometer|Gyro) range set to: "
            r"|Filter bandwidth set to: "
        ),
        stops=re.compile(r"Failed to find MPU6050 chip"),
        checks_chip=True,
        heard_within_s=1.0,
    ),
)
