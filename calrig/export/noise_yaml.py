"""What formats of an IMU's noise have in common: white noise and random walk of accelerometer and gyro."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from calrig.estimation.angles import AXES, STANDARD_GRAVITY_MPS2
from calrig.export.triads import NotHeldError


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


def sensor_noise(report: Mapping[str, Any], format_: str) -> tuple[SensorNoise, SensorNoise]:
    """The noise of accelerometer and gyro.

    `report` is of a noise study (CONTRACT section 7); `format_` is what needs it, for a refusal.

    Raises:
        NotHeldError: it has no white noise of an axis.
    """
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


def origin_of_noise(report: Mapping[str, Any], origin: str, *sensors: SensorNoise) -> list[str]:
    """Lines of comment: which log this is of, and what it is too short for."""
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


def yaml_float(value: float) -> str:
    """With a point, which YAML 1.1 wants of a number with an exponent."""
    text = f"{value:.9e}"
    mantissa, exponent = text.split("e")
    return f"{float(mantissa)!r}e{exponent}"
