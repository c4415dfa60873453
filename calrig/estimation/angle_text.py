"""Angles in words: as many digits as show them, small ones in arcseconds as well."""

import math

SMALL_DEG = 0.01
"""Below it an angle is given in arcseconds as well."""
LEAST_DEG = 1e-9
"""Below it no decimals are written out."""


def angle_text(value_deg: float, digits: int = 3, std_deg: float | None = None) -> str:
    """Return an angle in words, with the digits that show it: `0.0301°`, `0.000201° (0.724″)`.

    `digits` are significant ones; `std_deg`, its standard error, then decides the digits of both.
    """
    in_degrees = number_text(value_deg, std_deg, digits, "°")
    if value_deg == 0.0 or not LEAST_DEG <= abs(value_deg) < SMALL_DEG:
        return in_degrees
    arcseconds_std = None if std_deg is None else 3600.0 * std_deg
    return f"{in_degrees} ({number_text(3600.0 * value_deg, arcseconds_std, digits, '″')})"


def number_text(value: float, std: float | None, digits: int, unit: str) -> str:
    """Return a number in words, with the digits that its standard error leaves it, and its unit."""
    if std is None or not (math.isfinite(std) and std > 0.0):
        shown = "0" if value == 0.0 else _written(value, _decimals(value, digits), digits)
        return f"{shown}{unit}"
    decimals = _decimals(max(std, LEAST_DEG), 2)
    if value != 0.0:  # one that its error hides is shown all the same, unless it is far smaller
        decimals = min(max(decimals, _decimals(value, 2)), decimals + 3)
    return f"{_written(value, decimals, digits)} ± {_written(std, decimals, 2)}{unit}"


def _decimals(value: float, digits: int) -> int:
    if not math.isfinite(value) or abs(value) < LEAST_DEG:
        return digits
    return max(0, digits - 1 - math.floor(math.log10(abs(value))))


def _written(value: float, decimals: int, digits: int) -> str:
    is_plain = value == 0.0 or LEAST_DEG <= abs(value) < 1e6
    return (f"{value:z.{decimals}f}" if is_plain else f"{value:.{digits}g}").replace("-", "−")
