"""How far a bench's clock may be from its centre's, and what is said of one that is further."""

import math

SHOWN_S = 2.0
MOST_S = 60.0
"""Beyond it a bench takes no orders: times of its runs would be wrong, and ages of orders with them."""


def is_refused(skew_s: float | None) -> bool:
    """Return whether a bench whose clock is so far ahead takes no orders."""
    return skew_s is not None and abs(skew_s) > MOST_S


def skew_in_words(skew_s: float | None) -> str | None:
    """Say how far a bench's clock is off; None if it is not, or that is not known.

    Args:
        skew_s: the bench's time less the centre's, s.
    """
    if skew_s is None or abs(skew_s) <= SHOWN_S:
        return None
    off = f"its clock is {abs(skew_s):.0f} s {'ahead of' if skew_s > 0 else 'behind'} the centre's"
    stopped = f" (at most {MOST_S:g} s), so it takes no orders" if is_refused(skew_s) else ""
    return f"{off}{stopped}: synchronise both clocks (NTP)"


def said_skew_s(said: object) -> float | None:
    """Return what a bench said of its clock, if it is a number."""
    if not isinstance(said, int | float) or isinstance(said, bool) or not math.isfinite(said):
        return None
    return float(said)
