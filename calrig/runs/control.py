"""Requests to a run in progress, each from another thread: pause, resume, end."""

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from calrig.instruments.clock import WALL, Clock, Event
from calrig.instruments.errors import InstrumentError
from calrig.model.run import Status
from calrig.store.trail import Act

log = logging.getLogger(__name__)

ENDED = "the run has ended"


@dataclass(frozen=True, slots=True)
class End:
    """How a run was asked to end: the status it is to have, why, and by whom where that is known."""

    status: Status
    reason: str | None
    who: str | None = None

    @property
    def asked(self) -> Act | None:
        """What is entered in the trail; None unless a person asked for it."""
        return Act("aborted", self.who) if self.status == "aborted" else None


class Ended(Exception):  # noqa: N818 (a request that was met, not an error)
    """Unwinds a run that was asked to end."""

    def __init__(self, end: End) -> None:
        super().__init__(end.reason)
        self.end = end


@dataclass(frozen=True, slots=True)
class StopOutcome:
    """How a run left its stage.

    Attributes:
        seen: whether it was told to stop and looked at; False where its port was never opened, or it never
            moved and nobody asked for a stop.
        trouble: what a person must know where it is not known to stand.
    """

    seen: bool
    trouble: str | None = None


class ResumeRequest:
    """A person's word that what a run waits for is done; the run looks, and answers."""

    def __init__(self, answered: Event, who: str | None = None) -> None:
        self._answered = answered
        self.who = who
        self._refusal: str | None = None

    def answer(self, refusal: str | None) -> None:
        """Says why the run cannot go on, or None: it does."""
        if not self._answered.is_set():
            self._refusal = refusal
            self._answered.set()

    def refusal(self, timeout_s: float) -> str | None:
        """The answer, waiting for it so many seconds of the run's clock."""
        if not self._answered.wait(timeout_s):
            return "the unit's board has not said how it is clamped: look at its cable, and ask again"
        return self._refusal


class Control:
    """The requests made of one run. A request to end halts the stage from the asking thread, at once.

    Args:
        clock: of the run's rig, by which those wait who want to hear that the stage stands.

    Attributes:
        asked: the end that was asked for first.
        paused, resumed: who wished for the pause, and who ended it.
    """

    def __init__(self, clock: Clock = WALL) -> None:
        self._lock = threading.Lock()
        self.asked: End | None = None
        self._halt: Callable[[], None] | None = None
        self._hold = threading.Event()
        self.paused, self.resumed = Act("paused", None), Act("resumed", None)
        self._left: StopOutcome | None = None
        self._clock = clock
        self._go: ResumeRequest | None = None
        self.is_waiting = False
        self._has_left = clock.event()
        self._reached = clock.event()

    def arm(self, halt: Callable[[], None]) -> None:
        """Says how to stop the stage; called once it is open."""
        with self._lock:
            self._halt = halt
            already_asked = self.asked is not None
        self._reached.set()
        if already_asked:
            _send(halt)

    def end(self, end: End) -> None:
        """Asks the run to end; the first request decides the status, each one halts the stage again."""
        with self._lock:
            self.asked = self.asked or end
            halt = self._halt
        if halt is not None:
            _send(halt)

    def check(self) -> None:
        """Raises Ended where an end was asked for."""
        if self.asked is not None:
            raise Ended(self.asked)

    def leave(self, left: StopOutcome) -> None:
        """The run has left its stage, as it says; what it said first holds."""
        self._left = self._left or left
        self._has_left.set()
        self._reached.set()

    def reached(self, timeout_s: float) -> bool:
        """Whether the stage is open, or was left, waiting for that for so many seconds of its rig's time."""
        self._reached.wait(timeout_s)
        return self._reached.is_set()

    def left(self, timeout_s: float) -> StopOutcome | None:
        """How the run left its stage, waiting for that for so many seconds of its rig's time; else None."""
        self._has_left.wait(timeout_s)
        return self._left

    def pause(self, who: str | None = None) -> None:
        """Asks the run to hold after the pose in hand."""
        self.paused = Act("paused", who)
        self._hold.set()

    def resume(self, who: str | None = None) -> None:
        """Takes the wish for a pause back, or ends the pause."""
        self.resumed = Act("resumed", who)
        self._hold.clear()

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """While it lasts the run stands until a person says Go."""
        self.is_waiting = True
        try:
            yield
        finally:
            with self._lock:
                self.is_waiting, left = False, self._go
            if left is not None:
                left.answer(ENDED)

    def say_go(self, who: str | None = None) -> ResumeRequest | None:
        """Says so, and gives what will be answered; who asks meanwhile shares it. None where none waits."""
        with self._lock:
            if not self.is_waiting:
                return None
            self._go = self._go or ResumeRequest(self._clock.event(), who)
            return self._go

    def take_go(self) -> ResumeRequest | None:
        """What was said since it was last taken."""
        with self._lock:
            said, self._go = self._go, None
            return said

    @property
    def holding(self) -> bool:
        """Whether a pause is wished."""
        return self._hold.is_set()


def _send(halt: Callable[[], None]) -> None:
    """Halts the stage; a port that is gone or closed keeps nobody's request from being met.

    The run itself comes upon the same port when it leaves the rig, and says what became of the stage.
    """
    try:
        halt()
    except InstrumentError as error:
        log.warning("a stop could not be sent: %s", error)
