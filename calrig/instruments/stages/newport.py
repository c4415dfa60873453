"""Newport controllers: what the drivers of SMC100 and ESP301 have in common.

Nothing on this serial link has a checksum. So a number that a flipped bit could turn into another is queried
until two answers agree, and after a move the controller is queried for the target that it has taken (`PA?`).
Commands have no reply: after each one the controller is queried for its error.
"""

import math
import re
import threading
from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from typing import ClassVar, Self

from calrig.instruments import standstill
from calrig.instruments.errors import StageError
from calrig.instruments.ports import Port, open_port
from calrig.instruments.stages.lines import LineWire, plain, unanswered
from calrig.instruments.types import StageStatus

REPLY_TIMEOUT_S = 0.5
ATTEMPTS = 4
MOST_READS = 5
MOST_SENT = 5
NEAR_DEG = 0.5


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a command was refused, in words, and whether it may have been damaged on its way."""

    words: str
    perhaps_damaged: bool


class NewportStage(ABC):
    """One axis of a controller on a port, in the stage's own degrees. Opening it moves nothing.

    One thread sends queries and commands; any thread may halt.

    Attributes:
        title: driver and axis, with `{}` for the axis.
        line_form: what ends a reply.
        command_end: what ends a command.
        number_form: a number as a reply has it, the number alone in its first group.
        optional_attempts: how often a query is sent that not every controller knows.
        addressed_by: what the user calls the number that the commands begin with.
    """

    title: ClassVar[str]
    baudrate: ClassVar[int]
    line_form: ClassVar[re.Pattern[bytes]]
    command_end: ClassVar[str]
    number_form: ClassVar[re.Pattern[str]]
    position_query: ClassVar[str]
    optional_attempts: ClassVar[int]
    addressed_by: ClassVar[str]

    def __init__(self, port: Port, axis: int = 1) -> None:
        self.faults: Counter[str] = Counter()
        self._axis = axis
        self._name = f"stage {self.title.format(axis)} on {port.name}"
        self._lines = LineWire(port, self.faults, self.line_form)
        self._now_s = port.clock.now_s
        self._asking = threading.RLock()
        self._misread: str | None = None  # the last reply to the query under way that could not be read
        self._tells_target: bool | None = None  # unknown before the first query

    @classmethod
    def open(cls, url: str, *, axis: int = 1, baudrate: int | None = None) -> Self:
        """Open the port (PortError); send nothing yet."""
        return cls(open_port(url, baudrate=baudrate or cls.baudrate, timeout_s=0.02), axis)

    @abstractmethod
    def status(self) -> StageStatus:
        """Query the state, and return it in words (StageError without a reply)."""

    @abstractmethod
    def _moves(self) -> bool:
        """Query whether the stage moves (StageError without a reply)."""

    @abstractmethod
    def _ask(self, query: str, form: re.Pattern[str], attempts: int = ATTEMPTS) -> re.Match[str] | None:
        """Return the reply to a query; None without one. After a stop, send the query only once."""

    @abstractmethod
    def _forget_errors(self) -> None:
        """Clear errors of earlier commands from the controller's memory."""

    @abstractmethod
    def _refusal(self) -> Refusal | None:
        """Query why the last command was refused; None if it was accepted."""

    def position_deg(self) -> float:
        """Return the position at rest: two reads in a row that agree, three on a link with faults.

        Raises:
            StageError: no reply, or the reads differ although the stage is at rest.
        """
        with self._asking:
            return standstill.position_deg(self._name, self.glimpse_deg, self._moves, self.faults)

    def glimpse_deg(self) -> float:
        """Return one unchecked read: to show a stage on the move, never for a result."""
        return float(self._must(self.position_query, self.number_form)[1])

    def set_velocity(self, velocity_dps: float) -> None:
        """Set the velocity of the moves that follow.

        Raises:
            StageError: refused, or the controller reports another velocity than the one sent.
        """
        with self._asking:
            for _ in range(MOST_SENT):
                self._command(f"VA{plain(velocity_dps)}")
                took_dps = self._number("VA?")
                if took_dps is None or math.isclose(took_dps, velocity_dps, rel_tol=0.01):
                    return
        raise StageError(
            f"{self._name} did not accept the velocity {velocity_dps:g}: it reports {took_dps:g}; "
            "check the serial cable"
        )

    def move(self, target_deg: float) -> None:
        """Begin a move, and query the target that the controller took; send it again if it took none.

        Raises:
            StageError: refused, in the controller's words, or taken for another target and stopped.
            Halted: the stage was halted; nothing was sent.
        """
        command = f"PA{plain(target_deg)}"
        with self._asking:
            stood_deg = self.position_deg()
            for _ in range(MOST_SENT):
                refusal = self._send(command, motion=True)
                took_deg = self._took_deg(target_deg)
                if took_deg is None or (refusal is None and standstill.agree(took_deg, target_deg)):
                    break
                moved = self._moves() or not standstill.agree(self.position_deg(), stood_deg)
                if moved and standstill.agree(took_deg, target_deg):
                    return  # the move is the one sent: the report of a refusal was damaged
                if abs(took_deg - self.position_deg()) < NEAR_DEG and self._moves():
                    break  # the answer is the position on the way: this controller reports no target
                if moved:
                    self.halt()
                    raise StageError(
                        f"{self._name} took {command} for a move to {took_deg:g} and was stopped: "
                        "check the serial cable"
                    )
                if refusal is not None and not refusal.perhaps_damaged:
                    break
                self.faults["resent"] += 1
            else:
                if refusal is None:
                    raise StageError(
                        f"{self._name} did not accept {command} after repeated attempts: its target is "
                        f"still {took_deg:g}; check the serial cable"
                    )
            if refusal is not None:
                raise StageError(f"{self._name} refused {command}: {refusal.words}")

    def halt(self) -> None:
        """Stop the stage now, from any thread, without waiting for a reply; later motion raises Halted."""
        self._lines.halt(self._line("ST"))

    def close(self) -> None:
        """Close the port; never raises."""
        with self._asking:
            self._lines.close()

    def _command(self, command: str, *, motion: bool = False) -> None:
        """Send a command once (StageError if it is refused)."""
        with self._asking:
            if refusal := self._send(command, motion=motion):
                raise StageError(f"{self._name} refused {command}: {refusal.words}")

    def _send(self, command: str, *, motion: bool) -> Refusal | None:
        self._forget_errors()  # an old error must not be taken for this command's
        if motion:
            self._lines.send_motion(self._line(command), self._name)
        else:
            self._lines.send(self._line(command))
        return self._refusal()

    def _line(self, command: str) -> bytes:
        return f"{self._axis}{command}{self.command_end}".encode("ascii")

    def _took_deg(self, sent_deg: float) -> float | None:
        """Return the target that the controller has, queried twice if it differs; None if it reports none."""
        if self._tells_target is None:
            self._tells_target = self._ask("PA?", self.number_form, self.optional_attempts) is not None
        if not self._tells_target:
            return None
        took_deg = float(self._must("PA?", self.number_form)[1])
        if standstill.agree(took_deg, sent_deg):
            return took_deg
        return float(self._must("PA?", self.number_form)[1])

    def _number(self, query: str) -> float | None:
        """Return a setting once two replies in a row agree; None without a reply (StageError: none agree)."""
        last = None
        for _ in range(MOST_READS):
            reply = self._ask(query, self.number_form, self.optional_attempts)
            value = None if reply is None else float(reply[1])
            if value is None or value == last:
                return value
            last = value
        raise StageError(f"{self._name}: replies to {query} differ each time: check the serial cable")

    def _must(self, query: str, form: re.Pattern[str]) -> re.Match[str]:
        self._misread = None
        reply = self._ask(query, form)
        if reply is None:
            check = f"power, cable, {self.addressed_by} and baud rate"
            raise StageError(unanswered(self._name, query, self.faults, check, self._misread))
        return reply
