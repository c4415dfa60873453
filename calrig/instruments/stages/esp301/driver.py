"""Newport ESP301 (driver `esp301`): ESP301 user's manual; axes 1–3, 19200 baud on RS-232, commands end CR.

Its replies are bare numbers that do not say which query they answer. So each query is followed by a fence,
`VE?` or `1ID?` in turn, whose text was learned at the first query: replies come in order, so exactly one
number before the fence is the answer. None or two are damage, and the query is sent again.

No query tells whether the stage was homed since power-up. It counts as not referenced until this driver has
homed it, in the mode that the stage itself is set up for (`OM`). Error words: the manual's appendix A.
"""

import re
from itertools import cycle

from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.device import OpenStage
from calrig.instruments.errors import StageError
from calrig.instruments.ports import Port
from calrig.instruments.stages.esp301 import BAUDRATE
from calrig.instruments.stages.lines import LINE_END, plain
from calrig.instruments.stages.newport import ATTEMPTS, REPLY_TIMEOUT_S, NewportStage, Refusal
from calrig.instruments.types import StageIdentity, StageStatus

ERRORS = {
    1: "PCI communication time-out",
    4: "emergency stop",
    6: "unknown command",
    7: "parameter out of range",
    8: "cable interlock open",
    9: "axis number out of range",
    37: "axis number missing",
    38: "parameter missing",
    40: "the last command cannot be repeated",
}

AXIS_ERRORS = {
    0: "motor type not defined",
    1: "parameter out of range",
    2: "amplifier fault",
    3: "following error: the stage was blocked, or the motor lost power",
    4: "positive limit reached, or the target lies beyond it",
    5: "negative limit reached, or the target lies beyond it",
    6: "positive software limit reached, or the target lies beyond it",
    7: "negative software limit reached, or the target lies beyond it",
    8: "motor or stage not connected",
    9: "feedback signal fault: check the encoder's cable",
    10: "maximum velocity exceeded",
    11: "maximum acceleration exceeded",
    13: "motor not enabled",
    15: "maximum jerk exceeded",
    16: "maximum DAC offset exceeded",
    17: "critical settings are protected",
    18: "stage device error",
    19: "stage data invalid",
    20: "homing aborted",
    21: "motor current not defined",
    22: "drive communication error",
    23: "drive not detected",
    24: "speed out of range",
    26: "parameter change not allowed",
    27: "invalid trajectory mode for homing",
    28: "invalid encoder step ratio",
    29: "digital I/O interlock",
    30: "not allowed during homing",
    31: "not allowed in a group",
    32: "invalid trajectory mode for moving",
}

MOST_ERRORS = 11
"""Ten in its memory, and the 0 after them."""
PERHAPS_DAMAGED = (6, 7, 9, 37, 38)
"""Refusals of a command that may have been damaged on its way."""
PERHAPS_DAMAGED_OF_AXIS = (1, 4, 5, 6, 7)

NUMBER = re.compile(r"\s*([-+]?\d+(?:\.\d*)?(?:[Ee][-+]?\d{1,2})?)\s*")
CODE = re.compile(r"\s*(\d{1,4})\s*")
DONE = re.compile(r"\s*([01])\s*")
NAME = re.compile(r".*[A-Za-z]{2}.*\d.*")


class Esp301(NewportStage):
    """One axis of a controller on a port.

    RTS is raised and CTS not waited for: commands are shorter than the controller's memory for them, and a
    stop must not wait.
    """

    title = "esp301, axis {},"
    baudrate = BAUDRATE
    line_form = LINE_END
    command_end = "\r"
    number_form = NUMBER
    position_query = "TP?"
    optional_attempts = ATTEMPTS
    addressed_by = "axis"

    def __init__(self, port: Port, axis: int = 1) -> None:
        super().__init__(port, axis)
        self._fences: dict[str, str] = {}
        self._next_fence = cycle([""])
        self._in_doubt = False
        self._referenced = False
        self._homing = False
        self._fault: int | None = None

    def identify(self) -> StageIdentity:
        """Return firmware and limits (StageError without a reply)."""
        with self._asking:
            low, high = self._number("SL?"), self._number("SR?")
            velocity, acceleration = self._number("VA?"), self._number("AC?")
            self._forget_errors()  # of long ago, or of a query that this firmware does not know
            return StageIdentity(
                driver="esp301",
                firmware=self._fences.get("VE?"),
                limits_deg=None if low is None or high is None else (low, high),
                velocity_dps=velocity,
                acceleration_dps2=acceleration,
                homes_each_time=True,
            )

    def status(self) -> StageStatus:
        """Whether it moves and what its error memory holds, in words (StageError if it does not answer)."""
        with self._asking:
            if self._moves():
                if self._homing:
                    return StageStatus("homing", "HOMING")
                if self._referenced:
                    return StageStatus("moving", "MOVING")
                return StageStatus("homing", "MOVING, not by calrig")
            self._note_error()
            if self._homing and self._moves():
                return StageStatus("homing", "HOMING")  # between two passes of its search it stood
            if self._homing:
                self._homing, self._referenced = False, True
            return self._standing()

    def home(self) -> None:
        """Switches the motor on and begins to look for the reference; sent once.

        Raises:
            StageError: it moves, or refused, in words.
            Halted: it was halted; nothing was sent.
        """
        with self._asking:
            if self._moves():
                raise StageError(f"{self._name} homes only when it stands, and it moves")
            self._lines.refuse_if_halted("OR", self._name)
            self._command("MO")
            self._fault, self._referenced = None, False
            self._command("OR", motion=True)
            self._homing = True

    def move(self, target_deg: float) -> None:
        """Begin a move, as `NewportStage`; StageError also if the stage was not homed."""
        with self._asking:
            command = f"PA{plain(target_deg)}"
            self._lines.refuse_if_halted(command, self._name)
            if not self._referenced:
                raise StageError(
                    f"{self._name} was not homed since its port was opened: {command} was not sent"
                )
            super().move(target_deg)

    def _standing(self) -> StageStatus:
        if self._fault is not None:
            cut = ", and it sent a NUL byte, as when motor power is cut" if self._lines.nul_seen else ""
            return StageStatus("disabled", f"STOPPED: {error_words(self._fault)}{cut}")
        if not self._referenced:
            return StageStatus("not_referenced", "STANDING, not homed since its port was opened")
        return StageStatus("ready", "STANDING")

    def _moves(self) -> bool:
        return self._must("MD?", DONE)[1] == "0"

    def _refusal(self) -> Refusal | None:
        code = int(self._must("TE?", CODE)[1])
        if not code:
            return None
        of_axis = code // 100 == self._axis and code % 100 in PERHAPS_DAMAGED_OF_AXIS
        return Refusal(error_words(code), of_axis or code in PERHAPS_DAMAGED)

    def _forget_errors(self) -> None:
        for _ in range(MOST_ERRORS):
            if not self._note_error():
                return

    def _note_error(self) -> int:
        """Takes the oldest error from the controller's memory; one of this axis's motion is kept here."""
        code = int(self._must("TE?", CODE)[1])
        in_motion = self._homing or self._referenced
        if in_motion and (code // 100 == self._axis or code in (4, 8)):
            self._fault, self._referenced, self._homing = code, False, False
        return code

    def _ask(self, query: str, form: re.Pattern[str], attempts: int = ATTEMPTS) -> re.Match[str] | None:
        with self._asking:
            if not self._fences and not self._learn_fences():
                return None
            sent = query if query == "TE?" else f"{self._axis}{query}"
            for _ in range(1 if self._lines.halted else attempts):  # a stop goes first
                if reply := self._ask_once(sent, form):
                    return reply
        return None

    def _ask_once(self, sent: str, form: re.Pattern[str]) -> re.Match[str] | None:
        self._catch_up()
        fence = next(self._next_fence)
        self._lines.send(f"{sent}\r".encode("ascii"))
        came = self._listen(1, sent)
        self._lines.send(f"{fence}\r".encode("ascii"))
        came += self._listen(3, sent, fence)
        if not came:
            self.faults["no_reply"] += 1
        if came[-1:] != [self._fences[fence]]:
            self._in_doubt = True
        elif len(came) == 2:
            if reply := form.fullmatch(came[0]):
                return reply
            self._misread = came[0]
        for line in came:
            if line != self._fences[fence]:
                self.faults["late_reply" if NUMBER.fullmatch(line) else "unparsed"] += 1
        return None

    def _listen(self, most: int, *sent: str) -> list[str]:
        """Lines in reply, echoes left out, until `most` came, or a fence's text, or time is up."""
        deadline_s = self._now_s() + REPLY_TIMEOUT_S
        came: list[str] = []
        while len(came) < most and (line := self._lines.line(deadline_s)) is not None:
            if line in sent:
                self.faults["echo"] += 1
            else:
                came.append(line)
            if len(sent) > 1 and line == self._fences[sent[1]]:
                break
        return came

    def _catch_up(self) -> None:
        """Drops what has come, and after an answer that never came, what is still on its way."""
        raise_if_cancelled()
        late = self._lines.old_lines()
        if self._in_doubt:
            deadline_s = self._now_s() + REPLY_TIMEOUT_S
            while (line := self._lines.line(deadline_s)) is not None:
                late.append(line)
            self._in_doubt = False
        if late:
            self.faults["late_reply"] += len(late)

    def _learn_fences(self) -> bool:
        """Asks for the two names until each came twice alike; one of them is enough."""
        for query in ("VE?", f"{self._axis}ID?"):
            last = None
            for attempt in range(ATTEMPTS + 1):
                if self._lines.halted and (self._fences or (attempt and last is None)):
                    break  # a stop goes first
                self._catch_up()
                self._lines.send(f"{query}\r".encode("ascii"))
                came = [line for line in self._listen(1, query) if NAME.fullmatch(line)]
                if came and came[0] == last and last not in self._fences.values():
                    self._fences[query] = last
                    break
                last = came[0] if came else None
                self._in_doubt |= not came
        self._next_fence = cycle(self._fences)
        return bool(self._fences)


def error_words(code: int) -> str:
    """A code of `TE?` with what it means; an axis's own is 100 times the axis and a number."""
    known = AXIS_ERRORS.get(code % 100) if code >= 100 else ERRORS.get(code)
    return f"{known or 'an error this driver does not know'} (error {code})"


OPENS: OpenStage = Esp301.open
