"""Figures as they stand in sentences."""

from __future__ import annotations

import math


def deg(value: float) -> str:
    """Two significant digits and the sign of a degree, without an exponent where it stays readable."""
    return f"{significant(value)}°"


def significant(value: float) -> str:
    """Two significant digits; a minus sign as one reads it."""
    if value == 0.0 or not 1e-6 <= abs(value) < 1e6:
        return f"{value:.2g}".replace("-", "−", 1)
    return f"{value:.{max(0, 1 - math.floor(math.log10(abs(value))))}f}".replace("-", "−")


def percent(probability: float) -> str:
    """A probability; what rounds to none or all of it is told as a bound."""
    if probability < 5e-5:
        return "less than 0.01 %"
    if probability > 1.0 - 5e-5:
        return "more than 99.99 %"
    return f"{100.0 * probability:.{2 if probability < 0.01 or probability > 0.99 else 1}f} %"
