"""The serial link to a GRBL controller: each line by its kind, and every `ok` matched to its own command.

`ok` and `error:n` do not say what they answer. So every command is followed by the listing of settings
(`$$`), which moves nothing and looks like nothing else: lines are answered in order, so the last answer
before the listing is the command's own, and an earlier one, late or doubled, is ignored.
"""

import re
from collections import Counter, deque
from collections.abc import Callable

from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.ports import Port
from calrig.instruments.stages.grbl.protocol import (
    ALARM,
    BANNER,
    LOCKED_UNTIL_RESET,
    REMARK,
    REPLY,
    SETTING,
    TAKES_RESET,
    Report,
    is_report_before_1_1,
    parse_report,
)
from calrig.instruments.stages.lines import LineWire

REPLY_TIMEOUT_S = 0.5
GLANCE_S = 0.1
WAKE_TIMEOUT_S = 3.0
"""A boot loader listens for two before GRBL does."""
WAKE_AGAIN_S = 1.0
"""No boot loader follows on a reset by wire: the banner comes at once."""
RESET_TIMEOUT_S = 1.0
"""Of a controller that moves, the banner comes 0.53 s after the reset."""
ALARM_PAUSE_S = 1.0
"""After most alarms GRBL answers nothing and takes no reset for 0.5 s."""
ATTEMPTS = 4
MOST_LISTINGS = 6
MOST_REMARKS = 16
PERHAPS_DAMAGED = frozenset(
    f"error:{n}" for n in (1, 2, 3, 4, 11, 14, 20, 21, 22, 23, 24, 25, 26, 28, 31, 33, 36)
)
"""Refusals of a line that may have been damaged on its way."""
RESET = b"\x18"
STOP = b"!\x85"
"""Feed hold, and jog cancel for a jog."""
BUSY = "error:8"
"""How the listing itself is refused while a move is under way; no G-code ever is."""


class GrblLink:
    """One controller on a port.

    Attributes:
        firmware: from its banner, None before one was seen.
        resets: how many banners have come.
        alarm: the last alarm that came; None after it was dealt with.
        locked: an alarm came after which it answers nothing, not even `?`, until it is reset.
        misread: the last line in the brackets of a report that is none; None once one came.
        before_1_1: it reports as GRBL 0.9 and older do.
        answers: `ok` and `error:n` since the last command.
        settings: the last listing, as far as it has come.
    """

    def __init__(self, port: Port, faults: Counter[str]) -> None:
        self.lines = LineWire(port, faults)
        self._now_s = port.clock.now_s
        self.firmware: str | None = None
        self.resets = 0
        self.alarm: int | None = None
        self.locked = False
        self._pauses = False
        self.misread: str | None = None
        self.before_1_1 = False
        self.answers: list[str] = []
        self.settings: dict[int, float] = {}
        self._faults = faults
        self._report: Report | None = None
        self._remarks: deque[str] = deque(maxlen=MOST_REMARKS)
        self._listed = False
        self._in_doubt = False
        self._sent = ""

    def look(self, attempts: int = ATTEMPTS) -> Report | None:
        """Asks for a report; None where none comes."""
        for _ in range(1 if self.lines.halted else attempts):  # a stop goes first
            self.catch_up()
            self._report = None
            self._wait_out_pause()
            if self.locked:
                return None
            self.lines.send(b"?")
            if self.listen(lambda: self._report is not None or self._pauses or self.before_1_1):
                if self._report or not self._pauses or self.locked:
                    return self._report
                continue
            self._in_doubt = True
            if attempts > 1:  # one that is just waking up answers none
                self._faults["no_reply"] += 1
        return None

    def wake(self) -> Report | None:
        """Asks until it answers; a controller locked up by an alarm does so only after a reset."""
        report = self._look_for(WAKE_TIMEOUT_S)
        if report is None and not self.before_1_1:
            self.restart()
            report = self._look_for(WAKE_AGAIN_S)
        return report

    def _look_for(self, timeout_s: float) -> Report | None:
        deadline_s = self._now_s() + timeout_s
        while self._now_s() < deadline_s and not (self.before_1_1 or self.locked):
            if report := self.look(attempts=1):
                return report
        return None

    def look_in_passing(self) -> Report | None:
        """Asks for a report of a controller that is known to answer none for a while."""
        self.catch_up()
        self._report = None
        self.lines.send(b"?")
        self.listen(lambda: self._report is not None, GLANCE_S)
        return self._report

    def command(self, line: str, *, moving: str | None = None) -> str | None:
        """Sends a line that may be sent again, and returns its own `ok` or `error:n`; None: no such answer.

        `line` is without its end; `moving` is the stage's name where the line moves it (Halted after a stop).
        """
        data = f"{line}\n".encode("ascii")
        self._sent, own = line, None
        for _ in range(ATTEMPTS):
            self.catch_up()
            self._begin()
            damage = self._faults["unparsed"]
            if moving is None:
                self.lines.send(data)
            else:
                self.lines.send_motion(data, moving)
            self.listen(lambda: bool(self.answers) or self.alarm is not None)
            if self.alarm is not None:
                return None
            sound = self.fence() and self._faults["unparsed"] == damage and not self._answers_an_inquiry()
            own = self.answers.pop() if self.answers else None
            self._count_late(len(self.answers))
            self.answers = []
            if sound and own is not None and own not in PERHAPS_DAMAGED:
                return own
            self._faults["resent"] += 1
        return own if own in PERHAPS_DAMAGED else None

    def _answers_an_inquiry(self) -> bool:
        """Whether what has come is a late answer, in brackets, with an `ok` of its own."""
        return any(remark[0] == "[" and not remark.startswith("[MSG:") for remark in self._remarks)

    def inquire(self, line: str, form: re.Pattern[str], sure: re.Pattern[str] | None = None) -> str | None:
        """Asks for what is answered in brackets; what it says twice alike, or once where that is enough.

        The first group of `form` is what is returned; `sure` is found in an answer that no damage makes of
        another.

        Returns:
            None where it never says the same twice, or does not answer.
        """
        last = None
        for _ in range(1 if self.lines.halted else ATTEMPTS):
            self.catch_up()
            self._begin()
            self._sent = line
            self.lines.send(f"{line}\n".encode("ascii"))
            answered = self.listen(lambda: bool(self.answers) or self.locked)
            self._in_doubt |= not answered
            said = next((found[1] for remark in self._remarks if (found := form.fullmatch(remark))), None)
            self.answers = []
            if said is not None and (said == last or (sure and sure.search(said))):
                return said
            last = said
            if self.locked:
                return None
        return None

    def begin(self, line: str, moving: str) -> None:
        """Sends a line that is answered when it is done, and never sent again."""
        self.catch_up()
        self._begin()
        self._sent = line
        self.lines.send_motion(f"{line}\n".encode("ascii"), moving)

    def fence(self) -> bool:
        """Lists the settings; whether the listing came to its end, and before it all that was late."""
        self.settings, self._listed = {}, False
        self.lines.send(b"$$\n")
        passed = self.listen(lambda: self._listed or self.answers[-1:] == [BUSY], 2 * REPLY_TIMEOUT_S)
        if self.answers[-1:] == [BUSY]:
            self.answers.pop()
        self._in_doubt |= not passed
        return passed

    def settings_twice(self, *needed: int) -> dict[int, float]:
        """The settings, listed twice alike and with those needed among them; {} where they never are."""
        last: dict[int, float] = {}
        for _ in range(MOST_LISTINGS):
            raise_if_cancelled()
            before, last = last, dict(self.settings) if self.fence() else {}
            if last == before and last.keys() >= {*needed}:
                return last
        return {}

    def restart(self) -> bool:
        """Resets the controller once it takes a reset, which moves nothing; whether its banner came."""
        self._wait_out_pause()
        seen = self.resets
        self.lines.send(RESET)
        return self.listen(lambda: self.resets != seen, RESET_TIMEOUT_S)

    def _wait_out_pause(self) -> None:
        """After an alarm, wait until the controller answers or takes a reset again."""
        if self._pauses:
            self.listen(lambda: not self._pauses, ALARM_PAUSE_S)
            self._pauses = False

    def listen(self, until: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Takes in lines until something holds or time is up; whether it holds."""
        deadline_s = self._now_s() + (REPLY_TIMEOUT_S if timeout_s is None else timeout_s)
        while not until():
            line = self.lines.line(deadline_s)
            if line is None:
                return False
            self._take(line)
        return True

    def catch_up(self) -> None:
        """Takes in what has come; after an answer that never came, also what is still on its way."""
        raise_if_cancelled()
        for line in self.lines.old_lines():
            self._take(line)
        if self._in_doubt:
            self.listen(lambda: False)
            self._in_doubt = False

    def _begin(self) -> None:
        self._count_late(len(self.answers))
        self.answers, self.settings, self._listed = [], {}, False
        self._remarks.clear()

    def _count_late(self, n: int) -> None:
        if n:
            self._faults["late_reply"] += n

    def _take(self, line: str) -> None:
        if line.startswith("?"):  # an echo of what asked for the report
            self._faults["echo"] += 1
            line = line.lstrip("?")
        if report := parse_report(line):
            self._count_late(self._report is not None)  # each is asked for, and answered once
            self._report, self.misread = report, None
        elif REPLY.fullmatch(line):
            if self.settings and not self._listed and line == "ok":
                self._listed = True  # the end of a listing, and no command's answer
            else:
                self.answers.append(line)
        elif setting := SETTING.fullmatch(line):
            self._count_late(int(setting[1]) in self.settings)
            self.settings[int(setting[1])] = float(setting[2])
        elif alarm := ALARM.fullmatch(line):
            self.alarm = int(alarm[1])
            self.locked = self.alarm in LOCKED_UNTIL_RESET
            self._pauses = True
        elif banner := BANNER.fullmatch(line):
            self.firmware = banner[1]
            self.resets += 1
            self.locked = self._pauses = False
            self.answers, self.settings = [], {}  # of a line that an alarm refused, or of a failed homing
        elif line in ("$$", self._sent):
            self._faults["echo"] += 1
        elif is_report_before_1_1(line):
            self.before_1_1 = True
        elif REMARK.fullmatch(line):
            self._pauses &= line != TAKES_RESET
            self._remarks.append(line)
        elif line:
            self._take_unknown(line)

    def _take_unknown(self, line: str) -> None:
        self._faults["unparsed"] += 1
        if line[0] == "<" and line[-1] == ">":
            self.misread = line
