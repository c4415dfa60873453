"""Newport SMC100 (driver `smc100`): SMC100CC/PP user's manual; addresses 1–31, lines end CR LF.

Each reply begins as its query does. A query without a reply may still be answered later; before it is sent
again, a different query, the fence, is sent and answered: the controller replies in order, so that a late
reply has come by then. State and error words are those of the manual's commands TS and TE.
"""

import re

from calrig.instruments.cancellation import raise_if_cancelled
from calrig.instruments.device import OpenStage
from calrig.instruments.errors import StageError
from calrig.instruments.ports import Port
from calrig.instruments.stages.newport import ATTEMPTS, REPLY_TIMEOUT_S, NewportStage, Refusal
from calrig.instruments.stages.smc100 import BAUDRATE
from calrig.instruments.types import StageIdentity, StageStatus

STATES = {
    "0A": ("not_referenced", "NOT REFERENCED from reset"),
    "0B": ("not_referenced", "NOT REFERENCED from HOMING"),
    "0C": ("not_referenced", "NOT REFERENCED from CONFIGURATION"),
    "0D": ("not_referenced", "NOT REFERENCED from DISABLE"),
    "0E": ("not_referenced", "NOT REFERENCED from READY"),
    "0F": ("not_referenced", "NOT REFERENCED from MOVING"),
    "10": ("not_referenced", "NOT REFERENCED, the stage's memory reports an error"),
    "11": ("not_referenced", "NOT REFERENCED from JOGGING"),
    "14": ("configuration", "CONFIGURATION"),
    "1E": ("homing", "HOMING commanded over the wire"),
    "1F": ("homing", "HOMING commanded by the keypad"),
    "28": ("moving", "MOVING"),
    "32": ("ready", "READY from HOMING"),
    "33": ("ready", "READY from MOVING"),
    "34": ("ready", "READY from DISABLE"),
    "35": ("ready", "READY from JOGGING"),
    "3C": ("disabled", "DISABLE from READY"),
    "3D": ("disabled", "DISABLE from MOVING"),
    "3E": ("disabled", "DISABLE from JOGGING"),
    "46": ("moving", "JOGGING from READY"),
    "47": ("moving", "JOGGING from DISABLE"),
}

ERROR_BITS = (
    "negative end of run",
    "positive end of run",
    "peak current limit",
    "RMS current limit",
    "short circuit",
    "following error",
    "homing time-out",
    "wrong stage",
    "DC voltage too low",
    "80 W output power exceeded",
)

ERRORS = {
    "A": "unknown command",
    "B": "wrong controller address",
    "C": "parameter missing or out of range",
    "D": "command not allowed",
    "E": "home sequence already started",
    "F": "error code F, which the manual leaves unused",
    "G": "displacement out of limits",
    "H": "not allowed in NOT REFERENCED: home the stage first",
    "I": "not allowed in CONFIGURATION",
    "J": "not allowed in DISABLE",
    "K": "not allowed in READY",
    "L": "not allowed in HOMING",
    "M": "not allowed in MOVING",
    "N": "position out of the controller's software limit",
    "S": "communication time-out",
    "U": "error of the controller's EEPROM",
    "V": "error while executing the command",
    "W": "command not for this version",
    "X": "command not for this stage",
}

FENCES = ("TS", "TP", "VE")
NO_ERROR = "@"
PERHAPS_DAMAGED = "ABCN"
"""Refusals of a command that may have been damaged on its way: unknown, other address, out of range."""
ENABLE_TIMEOUT_S = 1.0

STATUS_FORM = re.compile(rf"([0-9A-Fa-f]{{4}})(?i:({'|'.join(STATES)}))")
LETTER_FORM = re.compile(r"\s*([@A-Z])")
TEXT_FORM = re.compile(r"\s*(\S.*?)\s*")
ANY_REPLY = re.compile(r"\d{1,2}[A-Z]{2}.+")


class Smc100(NewportStage):
    """One controller on a port."""

    title = "smc100 at address {}"
    baudrate = BAUDRATE
    line_form = re.compile(rb"\r?\n")
    """Not CR alone: a digit damaged to one would leave a number that looks whole."""
    command_end = "\r\n"
    number_form = re.compile(r"\s*([-+]?\d+(?:\.\d*)?(?:[Ee][-+]?\d{1,2})?)")
    position_query = "TP"
    optional_attempts = 2
    addressed_by = "address"

    def __init__(self, port: Port, axis: int = 1) -> None:
        super().__init__(port, axis)
        self._unanswered: set[str] = set()

    def identify(self) -> StageIdentity:
        """Return firmware and limits; switch the motor on if it is off (which moves nothing).

        Raises:
            StageError: no reply, or the controller stays in DISABLE.
        """
        if self.status().state == "disabled":
            self._enable()
        low, high = self._number("SL?"), self._number("SR?")
        firmware = self._ask("VE", TEXT_FORM, self.optional_attempts)
        return StageIdentity(
            driver="smc100",
            firmware=firmware[1] if firmware else None,
            limits_deg=None if low is None or high is None else (low, high),
            velocity_dps=self._number("VA?"),
            acceleration_dps2=self._number("AC?"),
        )

    def status(self) -> StageStatus:
        """Return state and error bits, in words (StageError without a reply); query twice what ends a run."""
        seen = self._status_once()
        return self._status_once() if seen.state in ("disabled", "configuration") else seen

    def home(self) -> None:
        """Begin homing. Sent once: a second `OR` could start a second search.

        Raises:
            StageError: the state is not NOT REFERENCED, the only one that allows homing; nothing was sent.
            Halted: the stage was halted.
        """
        status = self.status()
        if status.state != "not_referenced":
            raise StageError(f"{self._name} homes only from NOT REFERENCED and is in {status.words}")
        self._command("OR", motion=True)

    def _status_once(self) -> StageStatus:
        bits, code = self._must("TS", STATUS_FORM).groups()
        state, words = STATES[code.upper()]
        raised = [text for k, text in enumerate(ERROR_BITS) if int(bits, 16) >> k & 1]
        if state == "disabled" and self._lines.nul_seen:
            raised.append("it sent a NUL byte, as it does when motor power is cut")
        return StageStatus(state, f"{words} ({', '.join(raised)})" if raised else words)

    def _enable(self) -> None:
        self._lines.nul_seen = False
        self._command("MM1")
        deadline = self._now_s() + ENABLE_TIMEOUT_S
        while (status := self.status()).state == "disabled":
            if self._now_s() > deadline:
                raise StageError(
                    f"{self._name} stays in {status.words}: is motor power on, and the stage free to turn?"
                )

    def _moves(self) -> bool:
        return self.status().state in ("moving", "homing")

    def _forget_errors(self) -> None:
        self._must("TE", LETTER_FORM)

    def _refusal(self) -> Refusal | None:
        letter = self._must("TE", LETTER_FORM)[1]
        if letter == NO_ERROR:
            return None
        words = ERRORS.get(letter, "an error this driver does not know")
        return Refusal(f"{words} (error {letter})", letter in PERHAPS_DAMAGED)

    def _ask(self, query: str, form: re.Pattern[str], attempts: int = ATTEMPTS) -> re.Match[str] | None:
        with self._asking:
            for _ in range(1 if self._lines.halted else attempts):  # a stop goes first
                if query in self._unanswered and not self._pass_fence():
                    continue
                if reply := self._ask_once(query, form):
                    return reply
        return None

    def _pass_fence(self) -> bool:
        fence = next((query for query in FENCES if query not in self._unanswered), None)
        if fence and not self._ask_once(fence, TEXT_FORM):
            return False
        self._unanswered.clear()  # without a fence left, each has had its time-out to come in
        return True

    def _ask_once(self, query: str, form: re.Pattern[str]) -> re.Match[str] | None:
        raise_if_cancelled()
        for early in self._lines.old_lines():
            self._drop(early)
        self._lines.send(self._line(query))
        deadline_s = self._now_s() + REPLY_TIMEOUT_S
        prefix = f"{self._axis}{query[:2]}"
        while self._now_s() < deadline_s and (line := self._lines.line(deadline_s)) is not None:
            if line.startswith(prefix):
                if reply := form.fullmatch(line, len(prefix)):
                    return reply
                self._misread = line[len(prefix) :]
            self._drop(line)
        self._unanswered.add(query)
        self.faults["no_reply"] += 1
        return None

    def _drop(self, line: str) -> None:
        self.faults["late_reply" if ANY_REPLY.fullmatch(line) else "unparsed"] += 1


OPENS: OpenStage = Smc100.open
