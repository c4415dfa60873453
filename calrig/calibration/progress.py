"""How far a computation is, as a share of all there is to do."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]
"""Is told the share, 0 to 1."""
SOLVED = 0.65
"""Of solving jointly and holding out together, about, with four units as with thirty."""


def unheard(_share: float) -> None:
    """Nobody asked."""


def within(progress: Progress, begin: float, end: float) -> Progress:
    """Return the progress of a part that begins and ends at those shares of the whole."""
    return lambda share: progress((1.0 - share) * begin + share * end)
