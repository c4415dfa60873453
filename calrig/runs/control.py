"""What people ask of a run while it goes on: pause, resume, end. Each reaches the run from another thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

from calrig.instruments.errors import InstrumentError
from calrig.store import Status

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class End:
    """How a run was asked to end: the status it is to have, and why."""

    status: Status
    reason: str | None


class Ended(Exception):  # noqa: N818 (a request that was met, not an error)
    """Unwinds a run that was asked to end."""

    def __init__(self, end: End) -> None:
        super().__init__(end.reason)
        self.end = end


class Control:
    """The requests made of one run. A request to end halts the stage from the asking thread, at once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._end: End | None = None
        self._halt: Callable[[], None] | None = None
        self._hold = threading.Event()

    def arm(self, halt: Callable[[], None]) -> None:
        """Says how to stop the stage; called once it is open."""
        with self._lock:
            self._halt = halt
            already_asked = self._end is not None
        if already_asked:
            _send(halt)

    def end(self, end: End) -> None:
        """Asks the run to end; the first request decides the status, each one halts the stage again."""
        with self._lock:
            self._end = self._end or end
            halt = self._halt
        if halt is not None:
            _send(halt)

    def check(self) -> None:
        """Raises Ended where an end was asked for."""
        if self._end is not None:
            raise Ended(self._end)

    def pause(self) -> None:
        """Asks the run to hold after the pose in hand."""
        self._hold.set()

    def resume(self) -> None:
        """Takes the wish for a pause back, or ends the pause."""
        self._hold.clear()

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
