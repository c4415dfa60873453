"""The GRBL controller's count of steps: whether it is the stage's angle, and which angle.

GRBL counts its own steps and does not measure the table. Its count is the angle from a homing on or, without
homing, from the position at power-up; it stops being the angle at an alarm, a reset or a jump.

`Marks` are words in the modal state (`$G`) that show a reset or another program's lines. A reset is announced
by a banner, which may be lost on the serial link, and a count that begins again at 0 looks like one that has
arrived there. As recorded from its firmware, GRBL 1.1 keeps these words:

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
from calrig.instruments.stages.grbl.protocol import MODES, Report, alarm_words
from calrig.instruments.stages.lines import plain
from calrig.instruments.standstill import AGREE_DEG

STATE_ANGLE = (
    "turn the stage to a known angle by hand and start a run that says so "
    '("The stage stands at" on the page, calrig run --stage-at DEGREES)'
)


class Count:
    """One axis's count.

    Attributes:
        unreferenced: why the count is no angle, None while it is one.
        lost: whether it was an angle and is none any more.
        offset_deg: the work coordinates' zero in machine coordinates, None before it was heard.
        shown_deg: the last one read.
        step_deg: the angle of one step.
        has_switch: whether a homing finds the angle again.
    """

    def __init__(self, index: int, name: str) -> None:
        self.unreferenced: str | None = "not homed since its port was opened"
        self.lost = False
        self.offset_deg: float | None = None
        self.shown_deg = 0.0
        self.step_deg = 0.0
        self.has_switch = True
        self._index = index
        self._name = name
        self._offset_heard: float | None = None
        self._has_moved = False
        self._target_deg: float | None = None
        self._rests_deg: float | None = None

    @property
    def has_moved(self) -> bool:
        """Whether a motion was commanded."""
        return self._has_moved

    def lose(self, why: str) -> None:
        """The count is no angle from here on."""
        self.lost, self.unreferenced = True, why

    def begin(self, target_deg: float | None) -> None:
        """A motion is sent: to a target, or None for homing, which makes good what was lost."""
        self._has_moved, self._target_deg, self._rests_deg = True, target_deg, None
        if target_deg is None:
            self.lost, self.unreferenced = False, "homing has not succeeded"

    def trust(self, report: Report) -> None:
        """Counts from where it was switched on; what angle that is, its user must know."""
        self.degrees(report)
        self.unreferenced = None

    def degrees(self, report: Report) -> float:
        """A report's angle in work coordinates (StageError where it has no such axis)."""
        if self._index >= len(report.position):
            raise StageError(f"{self._name}: the controller reports {len(report.position)} axes only")
        self.shown_deg = report.position[self._index] - ((self.offset_deg or 0.0) if report.machine else 0.0)
        return self.shown_deg

    def hear_offset(self, report: Report) -> None:
        """Takes in an offset, which is accepted when it has come twice alike."""
        if report.offset is None or self._index >= len(report.offset):
            return
        heard = report.offset[self._index]
        if heard == self._offset_heard and heard != self.offset_deg:
            if self.offset_deg is not None and self._has_moved:
                self.lose(f"its work coordinates were shifted by {heard - self.offset_deg:g}°")
            self.offset_deg = heard
        self._offset_heard = heard

    def require(self) -> None:
        """Raise StageError with what to do where the count was an angle and is none any more."""
        if self.lost:
            todo = "start again, so that it homes" if self.has_switch else STATE_ANGLE
            raise StageError(f"{self._name} has lost its angle: {self.unreferenced}; then {todo}")

    def check(self, here_deg: float) -> None:
        """Accept an angle at rest on which two reports agree.

        Raises:
            StageError: the count has jumped, or is no angle any more for another reason.
        """
        rests_deg = None if self.lost else self._rests_deg  # a reset, where one was seen, is why it jumps
        if rests_deg is not None and abs(here_deg - rests_deg) > AGREE_DEG:
            self.lose(f"its count jumped from {rests_deg:g}° to {here_deg:g}° while it stood")
        self.require()
        if self._target_deg is not None and abs(here_deg - self._target_deg) <= AGREE_DEG + self.step_deg:
            self._rests_deg = here_deg


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
