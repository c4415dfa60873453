"""A board whose port is open already when its run begins: opened once more, most boards would reset again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calrig.instruments.transcript import Tape, Tapes
from calrig.instruments.types import Board


@dataclass(frozen=True, slots=True)
class LeftOpen:
    """What a look leaves to the run after it, which closes it: the board, and the tapes of its port."""

    board: Board
    tapes: Sequence[Tape]

    def taken_over(self, tapes: Tapes) -> Board:
        """The board, for a run: what came over its wire before, and what was wrong then, is not the run's."""
        for tape in self.tapes:
            tapes.take_over(tape)
        self.board.faults.clear()
        return self.board
