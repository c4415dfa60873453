"""Channels' units, and a noise's coefficients as data sheets state them.

With σ(τ) = N/√τ, white noise of one-sided density √2·N per √Hz makes an angle wander by N·√t (IEEE Std 952,
annex C): N in °/s·√s is 60·N in °/√h, N in g·√s is 60·9.80665·N in m/s/√h.
"""

import math
from collections.abc import Container

from calrig.estimation.angles import STANDARD_GRAVITY_MPS2

_UNITS = {"g": "g", "dps": "°/s", "lsb": "LSB", "deg": "°", "c": "°C"}
_PER_HOUR, _ROOT_HOUR = 3600.0, 60.0


def unit_of(channel: str) -> str:
    """The unit that a channel's name ends in, as a person writes it; empty for one that is not known."""
    return _UNITS.get(channel.rpartition("_")[2], "")


def accelerometer_channels(names: Container[str], axes: str = "yz") -> list[str] | None:
    """Return the channels of an accelerometer's axes, all of one unit; None where one is missing."""
    for unit in ("g", "lsb"):
        found = [f"accel_{axis}_{unit}" for axis in axes]
        if all(name in names for name in found):
            return found
    return None


def quantity(value: float, unit: str) -> str:
    """Three significant digits and the unit."""
    space = "" if unit in {"", "°"} else " "
    return f"{float(f'{value:.3g}'):g}{space}{unit}"


def white_density(channel: str, n: float) -> str:
    """One-sided noise density of white noise of coefficient `n`: µg/√Hz, °/s/√Hz, °/√Hz, LSB/√Hz."""
    density, unit = math.sqrt(2.0) * n, unit_of(channel)
    return quantity(1e6 * density, "µg/√Hz") if unit == "g" else quantity(density, f"{unit}/√Hz")


def white_random_walk(channel: str, n: float) -> str | None:
    """Return what integrating that noise wanders by, °/√h or m/s/√h; None where an integral means nothing."""
    if channel.endswith("_dps"):
        return quantity(_ROOT_HOUR * n, "°/√h")
    if channel.endswith("_g"):
        return quantity(_ROOT_HOUR * STANDARD_GRAVITY_MPS2 * n, "m/s/√h")
    return None


def bias_instability(channel: str, b: float) -> str:
    """Flicker's coefficient B: µg, °/h, °, LSB."""
    if channel.endswith("_dps"):
        return quantity(_PER_HOUR * b, "°/h")
    return quantity(1e6 * b, "µg") if channel.endswith("_g") else quantity(b, unit_of(channel))


def level(channel: str, value: float) -> str:
    """Return a value of the channel, small ones of g in mg."""
    unit = unit_of(channel)
    return quantity(1e3 * value, "mg") if unit == "g" and abs(value) < 0.1 else quantity(value, unit)
