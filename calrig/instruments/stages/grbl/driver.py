"""GRBL 1.1 (driver `grbl`): an Arduino with a stepper shield rotating the stage, one unit per degree.

`axis` 1 is X, 2 Y, 3 Z. Angles are work coordinates: an offset that an operator has stored (`G54`) is kept.
Once its count is no longer the stage's angle (`Count`), `move` refuses and `position_deg` raises until the
stage is homed. A controller locked by an alarm is reset, which moves nothing and unlocks nothing. `$X` is
sent in one case only: after a soft limit alarm, in which no step is lost.

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

import contextlib
import re
import threading
from collections import Counter
from typing import Self

from calrig.instruments import standstill
from calrig.instruments.device import OpenStage
from calrig.instruments.errors import InstrumentError, StageError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.stages.grbl.link import RESET, STOP, GrblLink
from calrig.instruments.stages.grbl.protocol import (
    BAUDRATE,
    MODES,
    NOT_1_1,
    SOFT_LIMIT,
    VERSION,
    Report,
    alarm_words,
    error_words,
)
from calrig.instruments.stages.grbl.settings import RATE, ControllerSettings
from calrig.instruments.stages.lines import plain, unanswered
from calrig.instruments.standstill import AGREE_DEG
from calrig.instruments.types import StageIdentity, StageStatus

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
        has_moved: whether a motion was commanded.
    """

    def __init__(self, index: int, name: str) -> None:
        self.unreferenced: str | None = "not homed since its port was opened"
        self.lost = False
        self.offset_deg: float | None = None
        self.shown_deg = 0.0
        self.step_deg = 0.0
        self.has_switch = True
        self.has_moved = False
        self._index = index
        self._name = name
        self._offset_heard: float | None = None
        self._target_deg: float | None = None
        self._rests_deg: float | None = None

    def lose(self, why: str) -> None:
        """The count is no angle from here on."""
        self.lost, self.unreferenced = True, why

    def begin(self, target_deg: float | None) -> None:
        """A motion is sent: to a target, or None for homing, which makes good what was lost."""
        self.has_moved, self._target_deg, self._rests_deg = True, target_deg, None
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
            if self.offset_deg is not None and self.has_moved:
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


LOOKS_FOR_OFFSET = 24  # idle, GRBL adds its offset to every tenth report
ASSUMED_VELOCITY_DPS = 1.0  # of a controller that does not list its own
UNUSABLE = {
    "Hold": StageStatus("disabled", "HOLD: it stands, and keeps what is left of its move until it is reset"),
    "Door": StageStatus("disabled", "DOOR: the safety door is open"),
    "Sleep": StageStatus("disabled", "SLEEP: its motors are off"),
    "Check": StageStatus("configuration", "CHECK: it moves nothing until $C"),
}


class Grbl:
    """One controller on a port, one of its axes. Opening it moves nothing, but resets most Arduinos."""

    def __init__(self, port: Port, axis: int = 1) -> None:
        if not 1 <= axis <= 6:
            raise StageError(f"stage grbl on {port.name}: axis {axis} is not one of 1 (X) to 6 (C)")
        self.faults: Counter[str] = Counter()
        self._index = axis - 1
        self._letter = "XYZABC"[self._index]
        self._name = f"stage grbl, axis {self._letter}, on {port.name}"
        self._link = GrblLink(port, self.faults)
        self._count = Count(self._index, self._name)
        self._asking = threading.RLock()
        self._settings: ControllerSettings | None = None
        self._resets = 0
        self._homing = False
        self._marks = Marks(self._link, self._name)
        self._firmware: str | None = None
        self._feed_per_min: float | None = None

    @classmethod
    def open(cls, url: str, *, axis: int = 1, baudrate: int | None = None) -> Self:
        """Opens the port (PortError); asks nothing yet."""
        return cls(open_port(url, baudrate=baudrate or BAUDRATE, timeout_s=0.02), axis)

    def identify(self) -> StageIdentity:
        """Waits for it to wake, and reads its settings (StageError if it does not answer, or is busy).

        With soft limits on (`$20`) it keeps to `$130` on one side of its origin; which one it was built for
        it does not say, so both are allowed here and its own alarm tells the rest.
        """
        with self._asking:
            report = self._report()
            settings = self._settings
            if settings is None:
                raise StageError(f"{self._name} is in {report.state}, not by calrig: reset it first")
            offset_deg, travel_deg = self._count.offset_deg or 0.0, settings.travel_deg
            return StageIdentity(
                driver="grbl",
                firmware=self._firmware or self._link.firmware,
                limits_deg=(-travel_deg - offset_deg, travel_deg - offset_deg) if travel_deg else None,
                velocity_dps=settings.velocity_dps,
                acceleration_dps2=settings.acceleration_dps2,
                homes=settings.homes,
                homes_each_time=settings.homes,
                warnings=settings.warnings,
            )

    def status(self) -> StageStatus:
        """State and alarm in words (StageError if it does not answer)."""
        with self._asking:
            report = None
            if self._homing:
                report = self._link.look_in_passing()
                self._heed()
            if self._homing and report is None:
                return StageStatus("homing", "HOME (it answers nothing until it is done)")
            return self._status(report or self._report())

    def position_deg(self) -> float:
        """Where a standing stage says it is: two reports in a row that agree, three on a wire with faults.

        Raises:
            StageError: it does not answer, never says the same twice, or has lost its angle.
        """
        with self._asking:
            for _ in range(standstill.MOST_READS):
                reports = [self._report() for _ in range(3 if self.faults.total() else 2)]
                places_deg = [self._count.degrees(report) for report in reports]
                if reports[-1].moves:
                    return places_deg[-1]
                same = len({report.state for report in reports}) == 1
                if same and standstill.agree(min(places_deg), max(places_deg)):
                    self._see_that_it_was_not_reset(reports[-1])
                    self._count.check(places_deg[-1])
                    return places_deg[-1]
        said = ", ".join(f"{place:g}" for place in places_deg)
        raise StageError(f"{self._name}: reports differ ({said}) though it stands: check the serial cable")

    def glimpse_deg(self) -> float:
        """One read, unchecked: to show a stage on the move, never for a result."""
        with self._asking:
            return self._count.shown_deg if self._homing else self._count.degrees(self._report())

    def set_velocity(self, velocity_dps: float) -> None:
        """Sets the velocity of the moves that follow (StageError above the controller's own)."""
        most_dps = self._most_dps
        if most_dps is not None and velocity_dps > most_dps * (1 + 1e-9):
            raise StageError(
                f"{self._name} turns at {most_dps:g}°/s at most (${RATE + self._index}): {velocity_dps:g}°/s"
            )
        self._feed_per_min = velocity_dps * 60

    def home(self) -> None:
        """Begins to look for the limit switch; sent once.

        Raises:
            StageError: it has no homing (`$22=0`), or is in a state that does not allow it.
            Halted: it was halted; nothing was sent.
        """
        with self._asking:
            self._link.lines.refuse_if_halted("$H", self._name)
            report = self._report()
            if self._settings and not self._settings.homes:
                raise StageError(
                    f"{self._name} has no homing ($22=0) and no angle ({self._count.unreferenced}): "
                    f"{'reset the controller, ' if report.state == 'Alarm' else ''}{STATE_ANGLE}"
                )
            if report.state not in ("Idle", "Alarm"):
                raise StageError(f"{self._name} homes only from Idle and Alarm and is in {report.state}")
            self._link.alarm, self._resets = None, self._link.resets
            self._count.begin(None)
            self._homing = True  # before it is sent: a stop from here on must be one that homing heeds
            self._link.begin("$H", self._name)
            self._link.listen(lambda: bool(self._link.answers) or self._link.alarm is not None, 0.2)
            self._heed()
            if not self._homing:
                raise StageError(f"{self._name} refused $H: {self._count.unreferenced}")

    def move(self, target_deg: float) -> None:
        """Begins a move.

        Raises:
            StageError: it has no reference, is not idle, or refused the move, in words.
            Halted: it was halted; nothing was sent.
        """
        command = f"G1 {self._letter}{plain(target_deg)}"
        with self._asking:
            self._link.lines.refuse_if_halted(command, self._name)
            before = self._report()
            self._see_that_it_was_not_reset(before)
            if before.state != "Idle" or self._count.unreferenced:
                raise StageError(f"{self._name} takes no move: it is in {self._status(before).words}")
            self._mark()
            self._see_that_it_was_not_reset(before)
            self._count.require()
            self._count.begin(target_deg)
            answer = self._link.command(f"{OF_A_LINE} {command}", moving=self._name)
            if self._link.alarm == SOFT_LIMIT:
                self._unlock(before)
                raise StageError(f"{self._name} refused {command}: {alarm_words(SOFT_LIMIT)}")
            if answer != "ok":
                self._see_that_it_was_not_reset(before)
                self._count.require()
            self._require_ok(command, answer)

    def halt(self) -> None:
        """Stops the stage now, from any thread, waiting for no answer; later motion raises Halted.

        Homing heeds no feed hold: there the controller is reset, which stops it dead.
        """
        self._link.lines.halt(STOP + RESET if self._homing else STOP)

    def close(self) -> None:
        """Closes the port; never raises. What a stop has left of a move is thrown away."""
        with self._asking:
            if self._link.lines.halted:
                with contextlib.suppress(InstrumentError):
                    report = self._link.look(attempts=1)
                    if report and report.state == "Hold" and not report.moves:
                        self._link.restart()
            self._link.lines.close()

    def _report(self) -> Report:
        """A report, of a controller that is awake and known (StageError if it does not answer)."""
        report = self._link.look() if self._settings else self._link.wake()
        if report is None and self._link.locked:  # its motor was stopped, and it answers only after a reset
            self._link.restart()
            report = self._link.look()
        self._heed()
        if report is None and self._link.before_1_1:
            raise StageError(f"{self._name} speaks as {self._link.firmware or 'a GRBL'} does, {NOT_1_1}")
        if report is None:
            self._settings = None  # they are read again when it answers again
            check = "power, cable and baud rate"
            raise StageError(unanswered(self._name, "?", self.faults, check, self._link.misread))
        self._count.hear_offset(report)
        if self._settings is None and report.state in ("Idle", "Alarm") and not self._homing:
            return self._learn(report)
        return report

    def _see_that_it_was_not_reset(self, report: Report) -> None:
        """Looks at an idle one's marks (StageError where it does not answer)."""
        why = self._marks.check() if report.state == "Idle" else None
        self._heed()
        if why is not None and not self._count.lost:
            self._marks.forget()
            self._count.lose(why)

    @property
    def _most_dps(self) -> float | None:
        return self._settings.velocity_dps if self._settings else None

    def _mark(self) -> None:
        """Sets feed rate and marks where they are not set."""
        feed_per_min = self._feed_per_min or (self._most_dps or ASSUMED_VELOCITY_DPS) * 60
        if self._marks.feed_per_min != feed_per_min:
            line = self._marks.line(feed_per_min)
            self._require_ok(line, self._link.command(line))
            self._marks.accepted(feed_per_min)

    def _learn(self, report: Report) -> Report:
        """Reads settings and offset, twice alike each, and whether the count can be an angle."""
        settings = ControllerSettings.read(self._link, self._index)
        if settings is None:
            raise StageError(f"{self._name} does not list its settings ($$) twice alike: check the cable")
        settings.require_usable(self._name)
        self._count.step_deg, self._count.has_switch = settings.step_deg, settings.homes
        for _ in range(LOOKS_FOR_OFFSET):
            if self._count.offset_deg is not None:
                break
            report = self._link.look() or report
            self._count.hear_offset(report)
        if (version := self._link.inquire("$I", VERSION)) is not None:
            self._firmware = f"Grbl {version}"
        self._settings = settings
        if not settings.homes and not self._count.has_moved and report.state == "Idle":
            self._count.trust(report)
            self.faults["zero_not_homed"] = 1
        return report

    def _heed(self) -> None:
        """Draws the consequences of what came unasked."""
        if self._link.resets != self._resets:
            self._resets, self._homing = self._link.resets, False
            self._marks.forget()
            if self._count.has_moved or self._count.unreferenced is None:
                self._count.lose("it was reset, and its count with it")
        if self._link.alarm is not None:
            self._homing = False
            self._count.lose(alarm_words(self._link.alarm))
        if self._homing and self._link.answers and self._link.answers[-1] != "ok":
            self._homing = False
            self._count.unreferenced = error_words(self._link.answers[-1])

    def _status(self, report: Report) -> StageStatus:
        if self._homing and report.state == "Idle" and (self._link.answers or self._link.fence()):
            self._heed()
            if self._homing:
                self._homing, self._count.unreferenced, self._link.answers = False, None, []
        if self._homing and report.state == "Alarm":  # while it homes, it reports nothing
            self._homing, self._count.unreferenced = False, "homing failed"
        state, why = report.state, self._count.unreferenced
        if self._homing or state == "Home":
            return StageStatus("homing", "HOME")
        if report.moves and self._settings is None:
            return StageStatus("homing", f"{state.upper()}, not by calrig")
        if report.moves:
            return StageStatus("moving", state.upper())
        if state in UNUSABLE:
            return UNUSABLE[state]
        if why or state == "Alarm":
            return StageStatus("not_referenced", f"{state.upper()} ({why or 'locked'})")
        place = "" if self._count.has_switch else ", counting from where it was switched on"
        return StageStatus("ready", f"IDLE{place}")

    def _require_ok(self, command: str, answer: str | None) -> None:
        self._heed()
        if answer is None:
            why = self._count.unreferenced or "no answer of its own came: check the serial cable"
            raise StageError(f"{self._name} did not accept {command}: {why}")
        if answer != "ok":
            raise StageError(f"{self._name} refused {command}: {error_words(answer)}")

    def _unlock(self, before: Report) -> None:
        """After a soft limit alarm, in which no step is lost: reset, compare the count, then unlock."""
        if self._link.restart():
            self._link.alarm, self._resets = None, self._link.resets
            self._marks.forget()
            after = self._link.look()
            if after and self._link.alarm is None and after.position == before.position:
                self._require_ok("$X", self._link.command("$X"))
                return
        self._count.lose("its count changed in a soft limit alarm")


OPENS: OpenStage = Grbl.open
