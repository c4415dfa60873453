"""What every trial shares: how much of it to run, and the counts that it gives back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Extent:
    """How much of a trial to run.

    Attributes:
        share: 1 for the counts that are promised, 0.1 for a tenth of each.
        seed: of everything random; the same seed and share try the same things.
        workers: processes at most.
    """

    share: float = 1.0
    seed: int = 1
    workers: int = 2

    def of(self, number: int) -> int:
        """This share of the promised number, at least one."""
        return max(1, round(self.share * number))


@dataclass(frozen=True)
class Count:
    """One line of the table: `counted` of `tried`, and what is promised.

    Attributes:
        what: in words, for example "wrong readings".
        tried: how many of what there were, for example "1,000 runs".
        aim: what is promised, for example "0".
        counted: what was counted.
        kept: whether the promise is kept.
        notes: for what went wrong, enough to try it again: seeds, kinds.
    """

    what: str
    tried: str
    aim: str
    counted: str
    kept: bool
    notes: tuple[str, ...] = ()


def none_of(what: str, tried: str, failures: list[str]) -> Count:
    """A count that is to be 0, from a line for each failure."""
    return Count(what, tried, "0", str(len(failures)), not failures, tuple(failures))


Trial = Callable[[Extent], list[Count]]
