"""What each sketch prints, written from its source: numbers in, bytes out."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import strategies as st

from calrig.instruments.boards.public_sketches import SKETCHES
from calrig.instruments.boards.sketch import Sketch


@dataclass(frozen=True)
class Text:
    """A sketch with its record as a `%` format, and how large its numbers get."""

    sketch: Sketch
    form: str
    largest: tuple[float, ...]

    def say(self, numbers) -> bytes:
        return (self.form % tuple(numbers)).encode()

    def records(self):
        """Records as the sketch can print them, some of their numbers alike."""
        if "%d" in self.form:
            return st.tuples(*[st.integers(-32768, 32767)] * len(self.largest))
        return st.tuples(
            *[st.integers(int(-100 * m), int(100 * m)).map(lambda n: n / 100) for m in self.largest]
        )


SKETCH = {sketch.driver: sketch for sketch in SKETCHES}
TEXTS = [
    Text(SKETCH["i2cdev-raw"], "a/g:\t%d\t%d\t%d\t%d\t%d\t%d\r\n", (32767,) * 6),
    Text(
        SKETCH["tkj-kalman"],
        "%.2f\t%.2f\t%.2f\t%.2f\t\t%.2f\t%.2f\t%.2f\t%.2f\t\r\n",
        (180, 180, 180, 180, 90, 180, 90, 90),
    ),
    Text(
        SKETCH["adafruit-plotter"],
        "AccelX:%.2f,AccelY:%.2f,AccelZ:%.2f, GyroX:%.2f,GyroY:%.2f,GyroZ:%.2f\r\n",
        (156,) * 3 + (4.36,) * 3,
    ),
    Text(
        SKETCH["adafruit-basic"],
        "Acceleration X: %.2f, Y: %.2f, Z: %.2f m/s^2\r\nRotation X: %.2f, Y: %.2f, Z: %.2f rad/s\r\n"
        "Temperature: %.2f degC\r\n\r\n",
        (78,) * 3 + (8.7,) * 3 + (85,),
    ),
    Text(SKETCH["mpu6050-light"], "X : %.2f\tY : %.2f\tZ : %.2f\r\n", (180, 90, 9000)),
    Text(SKETCH["tockn"], "angleX : %.2f\tangleY : %.2f\tangleZ : %.2f\r\n", (180, 90, 9000)),
    Text(SKETCH["dmp-ypr"], "ypr\t%.2f\t%.2f\t%.2f\r\n", (180, 90, 180)),
]
BY_DRIVER = {text.sketch.driver: text for text in TEXTS}

BANNERS = {
    "i2cdev-raw": b"Initializing I2C devices...\r\nTesting device connections...\r\n"
    b"MPU6050 connection successful\r\n",
    "adafruit-plotter": b"\r\n",
    "adafruit-basic": b"Adafruit MPU6050 test!\r\nMPU6050 Found!\r\nAccelerometer range set to: +-8G\r\n"
    b"Gyro range set to: +- 500 deg/s\r\nFilter bandwidth set to: 21 Hz\r\n\r\n",
    "mpu6050-light": b"MPU6050 status: 0\r\nCalculating offsets, do not move MPU6050\r\nDone!\n\r\n",
    "tockn": b"\r\n========================================\r\nCalculating gyro offsets\r\n"
    b"DO NOT MOVE MPU6050...\r\nDone!\r\nX : 0.52\r\nY : -1.33\r\nZ : 0.07\r\n"
    b"Program will start after 3 seconds\r\n========================================",
    "dmp-ypr": b"Initializing I2C devices...\r\nTesting device connections...\r\n"
    b"MPU6050 connection successful\r\n\nSend any character to begin DMP programming and demo: \r\n"
    b"Initializing DMP...\r\n>*......>......"
    b"0.00000,\t-1020.00000,\t278.00000,\t-11.00000,\t-3.00000,\t1.00000\n"
    b"\nEnabling DMP...\r\nEnabling interrupt detection (Arduino external interrupt 0)...\r\n"
    b"DMP ready! Waiting for first interrupt...\r\n",
}
ELECTRONIC_CATS = (
    b"Initializing MPU...\r\nTesting MPU6050 connection...\r\nMPU6050 connection successful\r\n"
    b"Updating internal sensor offsets...\n\r\n\t0\t0\t0\t0\t0\t0\n"
)
