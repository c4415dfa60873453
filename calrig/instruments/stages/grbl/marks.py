"""Marks in a GRBL's modal state (`$G`), by which a reset and another program's lines are seen.

A reset is announced by a banner, which may be lost on the serial link, and a count that begins again at 0
looks like one that has arrived there. As recorded from its firmware, GRBL 1.1 keeps these words:

- `S` (spindle speed; `M5` keeps the spindle off) survives moves, holds and program ends; a reset makes it 0.
- `T` is 0 after every G-code line that has none. Each line of calrig's has it, another program's has not.
- `F` survives like `S`. A move is sent as `G1` without `F`: a controller that was reset between the check
  and the move has no feed rate and refuses it (error:22), so that it does not move from a wrong count.

Units and distance mode go with every line, so that nothing set before changes how a move is read.
"""

from __future__ import annotations

import re

from calrig.instruments.errors import StageError
from calrig.instruments.stages.grbl.link import GrblLink
from calrig.instruments.stages.grbl.protocol import MODES, alarm_words
from calrig.instruments.stages.lines import plain

RESET_MARK = "S211"
LINE_MARK = "T211"
OF_A_LINE = f"G21 G90 G94 {LINE_MARK}"
"""Millimetres, which are degrees here; absolute; feed in units a minute; the mark of calrig's lines."""
_MARKED = re.compile(rf"\b{LINE_MARK} F\S+ {RESET_MARK}\b")


class Marks:
    """The marks on one controller.

    Attributes:
        feed_per_min: the feed rate that was set with them, None where there are none.
    """

    def __init__(self, link: GrblLink, name: str) -> None:
        self.feed_per_min: float | None = None
        self._link = link
        self._name = name
        self._marks: frozenset[str] = frozenset()

    def line(self, feed_per_min: float) -> str:
        """The line that sets the feed rate and, where it does not stand, the mark that a reset removes."""
        mark = "" if self._marks else f" M5 {RESET_MARK}"
        return f"{OF_A_LINE}{mark} F{plain(feed_per_min)}"

    def accepted(self, feed_per_min: float) -> None:
        """Note the marks as `$G` shows them once `line` was accepted (StageError without an answer)."""
        if not self._marks:  # a build without variable spindle shows no S
            self._marks = (self._words() or frozenset()) & {LINE_MARK, RESET_MARK}
        self.feed_per_min = feed_per_min

    def forget(self) -> None:
        """The controller was reset, and this is known."""
        self.feed_per_min, self._marks = None, frozenset()

    def check(self) -> str | None:
        """Return why the count is no angle any more; None while it is, or where nothing was marked yet.

        Raises:
            StageError: `$G` is not answered.
        """
        if self.feed_per_min is None:
            return None
        words = self._words()
        if words is None:
            return alarm_words(self._link.alarm or 0)
        feed = next((float(word[1:]) for word in words if word[0] == "F"), 0.0)
        if self._marks <= words and abs(feed - self.feed_per_min) <= 1:  # it is shown without decimals
            return None
        if RESET_MARK not in words and "T0" in words and feed == 0:
            return "it was reset, and its count with it"
        seen = " ".join(sorted(word for word in words if word[0] in "TFS"))
        return f"another program sends it G-code ({seen}; calrig set {' '.join(sorted(self._marks))})"

    def _words(self) -> frozenset[str] | None:
        """The modal state; None where an alarm came instead."""
        said = self._link.inquire("$G", MODES, _MARKED)
        if said is None and self._link.alarm is None:
            raise StageError(f"{self._name} does not answer $G with its modal state: check the serial cable")
        return None if said is None else frozenset(said.split())
