"""A unit's measured noise as the parameters that VINS-Fusion reads of an IMU.

`vins_estimator/src/factor/integration_base.h` adds (dt·acc_n)² and (dt·acc_w)² a sample, so that acc_n is the
standard deviation of a sample, N·√rate, and acc_w K·√rate; gyr_n and gyr_w of the gyro. N and K as Kalibr
has them.
"""

import math
from collections.abc import Mapping
from typing import Any

from calrig.estimation.angles import STANDARD_GRAVITY_MPS2
from calrig.export.formats import NoiseExporter
from calrig.export.noise_yaml import origin_of_noise, sensor_noise, yaml_float
from calrig.export.triads import comments


def vins(report: Mapping[str, Any], origin: str) -> str:
    """The parameters of the IMU in VINS-Fusion's configuration; as `kalibr`."""
    accelerometer, gyro = sensor_noise(report, "vins")
    rate_hz = float(report["rate_hz"])
    root = math.sqrt(rate_hz)
    values = {
        "acc_n": accelerometer.density * root,
        "gyr_n": gyro.density * root,
        "acc_w": accelerometer.random_walk * root,
        "gyr_w": gyro.random_walk * root,
        "g_norm": STANDARD_GRAVITY_MPS2,
    }
    walks = (one.density**2 for one in (accelerometer, gyro))
    said = [
        *origin_of_noise(report, origin, accelerometer, gyro),
        f"standard deviations of a sample at {rate_hz:.6g} Hz, m/s^2 and rad/s; others at another rate",
        "test vector, rate*(dt*acc_n)^2 and rate*(dt*gyr_n)^2, what velocity and angle gather in a second: "
        + ", ".join(f"{value:.9g}" for value in walks),
    ]
    rows = [f"{name}: {yaml_float(value)}" for name, value in values.items()]
    return "\n".join(["%YAML:1.0", *comments(said), "imu: 1", *rows, ""])


EXPORTER = NoiseExporter(
    name="vins",
    title="VINS (noise)",
    file_name="vins.yaml",
    contents="VINS-Fusion's `acc_n` …: the `kalibr` values as standard deviations of a sample at the "
    "log's rate",
    about_one_axis="–",
    write=vins,
)
