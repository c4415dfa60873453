"""Progress of a computation, as the share of the work that is done."""

from collections.abc import Callable

Progress = Callable[[float], None]
"""Callback that receives the share done, 0 to 1."""
SOLVED = 0.65
"""Approximate share of the joint fit in fit and held-out errors together, for 4 to 30 units."""


def unheard(_share: float) -> None:
    """Ignore the progress."""


def within(progress: Progress, begin: float, end: float) -> Progress:
    """Return the callback of a part that begins and ends at these shares of the whole."""
    return lambda share: progress((1.0 - share) * begin + share * end)
