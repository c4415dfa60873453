"""The unit of a column of one's own, by the end of its name: `azimuth_deg`, `supply_v`, `rate_v_per_s`."""

UNITS = {
    "deg": "°",
    "arcsec": "″",
    "rad": "rad",
    "mrad": "mrad",
    "dps": "°/s",
    "rps": "rad/s",
    "rpm": "1/min",
    "hz": "Hz",
    "c": "°C",
    "k": "K",
    "s": "s",
    "ms": "ms",
    "min": "min",
    "h": "h",
    "g": "g",
    "mg": "mg",
    "mps2": "m/s²",
    "v": "V",
    "mv": "mV",
    "a": "A",
    "ma": "mA",
    "w": "W",
    "pa": "Pa",
    "hpa": "hPa",
    "kpa": "kPa",
    "mbar": "mbar",
    "bar": "bar",
    "pct": "%",
    "m": "m",
    "mm": "mm",
    "um": "µm",
    "kg": "kg",
    "n": "N",
    "nm": "N·m",
    "ut": "µT",
    "lx": "lx",
}
"""As the end of a name, and as a person writes it."""
PER = "_per_"
TIMES = "·"
"""Between the names of columns that act as a product."""


def unit_of_column(name: str) -> str:
    """Return the unit as a person writes it; empty where the name carries none that is known."""
    if TIMES in name:
        units = [unit_of_column(factor) for factor in name.split(TIMES)]
        return TIMES.join(units) if all(units) else ""
    counted, per, time = name.lower().rpartition(PER)
    if per:
        upper = unit_of_column(counted)
        return f"{upper}/{UNITS[time]}" if upper and time in UNITS else ""
    stem, _, ending = name.lower().rpartition("_")
    return UNITS.get(ending, "") if stem else ""


def is_circle(name: str) -> bool:
    """Return whether a column is an angle, which 360° more leave where it is."""
    return unit_of_column(name) == UNITS["deg"]
