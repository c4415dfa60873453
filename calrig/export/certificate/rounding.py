"""Numbers as metrologists write them: an uncertainty with two digits, its value to the same place.

JCGM 100:2008, 7.2.6. Rounded from the shortest decimal that is the number, half away from zero.
"""

from __future__ import annotations

from decimal import ROUND_HALF_UP, Decimal

DIGITS = 2


def place_of(uncertainty: float, digits: int = DIGITS) -> int:
    """The power of ten of the last digit that is kept: −3 of 0.0123, 1 of 123; of 0.0996, which is 0.10, −2.

    Raises:
        ValueError: the uncertainty is not a positive number.
    """
    exact = Decimal(repr(float(uncertainty)))
    if not exact.is_finite() or exact <= 0:
        raise ValueError(f"an uncertainty of {uncertainty!r} has no digits")
    place = exact.adjusted() - digits + 1
    return max(place, _at(exact, place).adjusted() - digits + 1)


def rounded(value: float, place: int) -> str:
    """A number rounded to a power of ten, without an exponent; never −0."""
    exact = _at(Decimal(repr(float(value))), place)
    return format(abs(exact) if exact == 0 else exact, "f")


def with_uncertainty(value: float, uncertainty: float | None) -> tuple[str, str | None]:
    """A value and its uncertainty; without one the value has four digits, and None stands beside it."""
    if uncertainty is None or not uncertainty > 0.0:
        return by_itself(value, 4), None
    place = place_of(uncertainty)
    return rounded(value, place), rounded(uncertainty, place)


def by_itself(value: float, digits: int = DIGITS) -> str:
    """A number of which no uncertainty is known, to so many digits."""
    return "0" if value == 0.0 else rounded(value, place_of(abs(value), digits))


def _at(exact: Decimal, place: int) -> Decimal:
    """The number rounded to the place; places of 10 and more keep their zeros."""
    return (exact.scaleb(-place).quantize(Decimal(1), ROUND_HALF_UP)).scaleb(place)
