"""Whether a GRBL still works by what calrig told it: its modal state, read back with `$G`.

A reset is told by a banner, which may be lost on the wire, and a count that begins anew at 0 looks like one
that has arrived there. So the tool number, which GRBL keeps for nothing and every reset sets to 0, is set
to a mark of calrig's. Units and distance mode go with every move, in its own line: what another program has
set in between changes nothing.
"""

from __future__ import annotations

import re

from calrig.instruments.errors import StageError
from calrig.instruments.stages.grbl.wire import GrblWire
from calrig.instruments.stages.grbl.words import MODES, alarm_words

MARK = "T211"
OF_A_MOVE = "G21 G90 G94"
"""Millimetres, which are degrees here; absolute; feed in units a minute."""
CHANGED = frozenset({"G20", "G91", "G93"})
_MARKED = re.compile(rf"\b{MARK}\b")


class Modes:
    """The modal state of one controller.

    Attributes:
        marked: whether the mark was set, since when a reset can be known by it.
        changed: words in force that no move may be read by, as `check` last saw them.
    """

    def __init__(self, wire: GrblWire, name: str) -> None:
        self.marked = False
        self.changed: frozenset[str] = frozenset()
        self._wire = wire
        self._name = name
        self._coordinates: frozenset[str] = frozenset()

    def mark(self) -> str | None:
        """Sets the mark and notes the work coordinates; the answer to it, None where none came.

        Raises:
            StageError: `$G` is not answered.
        """
        answer = self._wire.command(MARK)
        if answer == "ok":
            self._coordinates = _coordinates(self._words())
            self.marked = True
        return answer

    def check(self) -> str | None:
        """Why the count is no angle any more; None while it is, or nothing was marked yet.

        Raises:
            StageError: `$G` is not answered.
        """
        if not self.marked:
            return None
        words = self._words()
        if MARK not in words:
            tool = next((word for word in sorted(words) if word.startswith("T")), "T0")
            if tool == "T0":
                return "it was reset, and its count with it"
            return f"another program sends it G-code (tool number {tool}, and {MARK} was set)"
        if _coordinates(words) != self._coordinates:
            return f"another program has selected work coordinates {'/'.join(_coordinates(words))}"
        return None

    def _words(self) -> frozenset[str]:
        said = self._wire.inquire("$G", MODES, _MARKED)
        if said is None:
            why = alarm_words(self._wire.alarm) if self._wire.alarm else "check the serial cable"
            raise StageError(f"{self._name} does not say its modal state ($G): {why}")
        words = frozenset(said.split())
        self.changed = words & CHANGED
        return words


def _coordinates(words: frozenset[str]) -> frozenset[str]:
    return words & {f"G{number}" for number in range(54, 60)}
