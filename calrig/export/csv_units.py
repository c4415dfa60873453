"""Units as people write them, in the names of columns, in a row of units or in cells, and their conversion.

Only what has one meaning is here: `rps` in brackets may be revolutions, `grad` degrees or gons.
"""

import math
import re
from dataclasses import dataclass

from calrig.estimation.angles import STANDARD_GRAVITY_MPS2


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: a value of it, times `factor` plus `offset`, is one in the first unit of its quantity."""

    symbol: str
    quantity: str
    factor: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        return self.symbol


_RADIAN = math.degrees(1.0)
_UNITS = {
    Unit("deg", "angle"): "deg degs degree degrees ° º ˚",
    Unit("rad", "angle", _RADIAN): "rad radian radians",
    Unit("mrad", "angle", _RADIAN / 1e3): "mrad",
    Unit("arcmin", "angle", 1 / 60): "arcmin ′ '",
    Unit("arcsec", "angle", 1 / 3600): 'arcsec ″ "',
    Unit("s", "time"): "s sec secs second seconds",
    Unit("ms", "time", 1e-3): "ms msec millisecond milliseconds",
    Unit("µs", "time", 1e-6): "us µs μs usec microsecond microseconds",
    Unit("ns", "time", 1e-9): "ns nanosecond nanoseconds",
    Unit("min", "time", 60.0): "min minute minutes",
    Unit("h", "time", 3600.0): "h hour hours",
    Unit("°C", "temperature"): "c °c ºc ˚c °_c degc deg_c ℃ celsius",
    Unit("K", "temperature", 1.0, -273.15): "k kelvin",
    Unit("°F", "temperature", 1 / 1.8, -32 / 1.8): "f °f ºf ˚f °_f degf deg_f ℉ fahrenheit",
    Unit("g", "acceleration"): "g gn g0",
    Unit("mg", "acceleration", 1e-3): "mg",
    Unit("µg", "acceleration", 1e-6): "ug µg μg",
    Unit("m/s²", "acceleration", 1 / STANDARD_GRAVITY_MPS2): "m/s² m/s2 m/s^2 m/s**2 m/s/s m·s⁻² m_s^-2 mps2",
    Unit("deg/s", "rate"): "dps deg/s deg/sec °/s º/s ˚/s degree/s degrees/s deg_s^-1",
    Unit("mdps", "rate", 1e-3): "mdps mdeg/s",
    Unit("rad/s", "rate", _RADIAN): "rad/s rad/sec rad_s^-1 rad·s⁻¹",
    Unit("LSB", "counts"): "lsb count counts",
    Unit("V", "voltage"): "v volt volts",
    Unit("%", "share"): "% pct percent",
}
_BY_TEXT = {text: unit for unit, texts in _UNITS.items() for text in texts.split()}
_SUFFIXES = {
    **{suffix: _BY_TEXT[suffix] for suffix in ("deg", "s", "c", "g", "dps", "mps2", "lsb", "v", "pct")},
    "rps": _BY_TEXT["rad/s"],
}
"""At the ends of names: the contract's, and those of covariates in its documents."""


def unit_of_text(text: str) -> Unit | None:
    """Return the unit that a text is, in brackets or not; None if it is none, or may be several."""
    bare = re.sub(r"^([\[(])(.*)[\])]$", r"\2", text.strip()).strip()
    return _BY_TEXT.get(re.sub(r"\s+", "_", bare.lower()))


def stem_and_unit(name: str) -> tuple[str, Unit | None]:
    """Return a column's name without the contract's unit at its end, and that unit; `pass` has none."""
    stem, _, suffix = name.rpartition("_")
    unit = _SUFFIXES.get(suffix) if stem else None
    return (name, None) if unit is None else (stem, unit)


def conversion(stated: Unit, wanted: Unit) -> tuple[float, float] | None:
    """Return factor and offset from one unit to another; None where they are of different quantities."""
    if stated == wanted:
        return 1.0, 0.0
    if stated.quantity != wanted.quantity:
        return None
    return stated.factor / wanted.factor, (stated.offset - wanted.offset) / wanted.factor
