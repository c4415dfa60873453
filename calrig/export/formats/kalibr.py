"""A unit's measured noise as the `imu.yaml` that Kalibr reads.

The wiki's "IMU Noise Model" and `kalibr_common/ConfigReader.py`: densities N of white noise in m/s²/√Hz and
rad/s/√Hz, random walks K of the biases in m/s³/√Hz and rad/s²/√Hz, one figure for all axes; a sample is taken
to scatter by N·√rate. With the Allan deviation's N/√τ and K·√(τ/3) (IEEE Std 952-1997, annex C) N is that N,
√2 smaller than a data sheet's one-sided density, and K that K.
"""

import math
from collections.abc import Mapping
from typing import Any

from calrig.export.formats import NoiseExporter
from calrig.export.noise_yaml import origin_of_noise, sensor_noise, yaml_float
from calrig.export.triads import comments

ROS_TOPIC = "/imu0"


def kalibr(report: Mapping[str, Any], origin: str) -> str:
    """Kalibr's `imu.yaml`.

    `report` is of a noise study (CONTRACT section 7), of the log that `origin` names.

    Raises:
        NotHeldError: it has no white noise of an axis.
    """
    accelerometer, gyro = sensor_noise(report, "kalibr")
    rate_hz = float(report["rate_hz"])
    values = {
        "accelerometer_noise_density": accelerometer.density,
        "accelerometer_random_walk": accelerometer.random_walk,
        "gyroscope_noise_density": gyro.density,
        "gyroscope_random_walk": gyro.random_walk,
    }
    of_sample = (density * math.sqrt(rate_hz) for density in (accelerometer.density, gyro.density))
    said = [
        *origin_of_noise(report, origin, accelerometer, gyro),
        "m/s^2/sqrt(Hz), m/s^3/sqrt(Hz), rad/s/sqrt(Hz), rad/s^2/sqrt(Hz)",
        "test vector, noise density (discrete): " + ", ".join(f"{value:.9g}" for value in of_sample),
    ]
    rows = [f"{name}: {yaml_float(value)}" for name, value in values.items()]
    return "\n".join(
        [*comments(said), *rows, f"rostopic: {ROS_TOPIC}", f"update_rate: {yaml_float(rate_hz)}", ""]
    )


EXPORTER = NoiseExporter(
    name="kalibr",
    title="Kalibr (noise)",
    file_name="kalibr.yaml",
    contents="`imu.yaml`: noise densities and random walks of the latest static run, of the noisiest axis",
    about_one_axis="–",
    write=kalibr,
)
