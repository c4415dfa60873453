"""A unit's measured noise as the YAML that Kalibr and VINS-Fusion read of an IMU.

Kalibr: the wiki's "IMU Noise Model" and `kalibr_common/ConfigReader.py`: densities N of white noise in
m/s²/√Hz and rad/s/√Hz, random walks K of the biases in m/s³/√Hz and rad/s²/√Hz, one figure for all axes; a
sample is taken to scatter by N·√rate. With the Allan deviation's N/√τ and K·√(τ/3) (IEEE Std 952-1997, annex
C) N is that N, √2 smaller than a data sheet's one-sided density, and K that K.

VINS-Fusion: `vins_estimator/src/factor/integration_base.h` adds (dt·acc_n)² and (dt·acc_w)² a sample, so that
acc_n is the standard deviation of a sample, N·√rate, and acc_w K·√rate; gyr_n and gyr_w likewise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from calrig.estimation.angles import AXES, STANDARD_GRAVITY_MPS2
from calrig.export.formats.triads import NotHeldError, comments

ROS_TOPIC = "/imu0"


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Of accelerometer (m/s²) or gyro (rad/s), the noisiest axis.

    Attributes:
        density: N, per √Hz.
        random_walk: K, per s·√Hz.
        is_bound: the log shows no random walk, and K is the largest that it would not show.
    """

    density: float
    random_walk: float
    is_bound: bool


def kalibr(report: Mapping[str, Any], origin: str) -> str:
    """Kalibr's `imu.yaml`.

    Args:
        report: of a noise study (CONTRACT section 7).
        origin: which log that is of.

    Raises:
        NotHeldError: it has no white noise of an axis.
    """
    accelerometer, gyro = _both(report, "kalibr")
    rate_hz = float(report["rate_hz"])
    values = {
        "accelerometer_noise_density": accelerometer.density,
        "accelerometer_random_walk": accelerometer.random_walk,
        "gyroscope_noise_density": gyro.density,
        "gyroscope_random_walk": gyro.random_walk,
    }
    of_sample = (density * math.sqrt(rate_hz) for density in (accelerometer.density, gyro.density))
    said = [
        *_said(report, origin, accelerometer, gyro),
        "m/s^2/sqrt(Hz), m/s^3/sqrt(Hz), rad/s/sqrt(Hz), rad/s^2/sqrt(Hz)",
        "test vector, noise density (discrete): " + ", ".join(f"{value:.9g}" for value in of_sample),
    ]
    rows = [f"{name}: {_float(value)}" for name, value in values.items()]
    return "\n".join(
        [*comments(said), *rows, f"rostopic: {ROS_TOPIC}", f"update_rate: {_float(rate_hz)}", ""]
    )


def vins(report: Mapping[str, Any], origin: str) -> str:
    """The parameters of the IMU in VINS-Fusion's configuration; as `kalibr`."""
    accelerometer, gyro = _both(report, "vins")
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
        *_said(report, origin, accelerometer, gyro),
        f"standard deviations of a sample at {rate_hz:.6g} Hz, m/s^2 and rad/s; others at another rate",
        "test vector, rate*(dt*acc_n)^2 and rate*(dt*gyr_n)^2, what velocity and angle gather in a second: "
        + ", ".join(f"{value:.9g}" for value in walks),
    ]
    rows = [f"{name}: {_float(value)}" for name, value in values.items()]
    return "\n".join(["%YAML:1.0", *comments(said), "imu: 1", *rows, ""])


def _both(report: Mapping[str, Any], format_: str) -> tuple[SensorNoise, SensorNoise]:
    return (
        _noise(report, "accel", "g", STANDARD_GRAVITY_MPS2, format_),
        _noise(report, "gyro", "dps", math.radians(1.0), format_),
    )


def _noise(report: Mapping[str, Any], sensor: str, unit: str, factor: float, format_: str) -> SensorNoise:
    densities, walks, bounds = [], [], []
    for axis in AXES:
        name = f"{sensor}_{axis}_{unit}"
        channel = report["channels"].get(name)
        white = None if channel is None else channel["coefficients"]["white"]
        if channel is None or white is None or white["value"] <= 0.0:
            raise NotHeldError(f"{format_} needs the white noise of {name}, and the log does not show it")
        walk, curve = channel["coefficients"]["random_walk"], channel["allan"]
        densities.append(white["value"])
        ends = zip(curve["high"], curve["tau_s"], strict=True)
        bounds.append(min(high * math.sqrt(3.0 / tau_s) for high, tau_s in ends))
        walks.append(None if walk is None else walk["value"])
    seen = [walk for walk in walks if walk is not None]
    return SensorNoise(factor * max(densities), factor * max(seen or bounds), not seen)


def _said(report: Mapping[str, Any], origin: str, *sensors: SensorNoise) -> list[str]:
    said = [
        f"calrig: {origin}, {report['duration_s']:.6g} s at {report['rate_hz']:.6g} Hz",
        "of the three axes the noisiest",
    ]
    for name, one in zip(("accelerometer", "gyro"), sensors, strict=True):
        if one.is_bound:
            said.append(
                f"the log is too short to show a random walk of the {name}: the largest that it could hide"
            )
    return said


def _float(value: float) -> str:
    """With a point, which YAML 1.1 wants of a number with an exponent."""
    text = f"{value:.9e}"
    mantissa, exponent = text.split("e")
    return f"{float(mantissa)!r}e{exponent}"
