"""Time that moves on when everybody waits, so that it takes no longer than what is done in it.

Who may run when is `scheduler`'s; a thread that the clock makes is a member of it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from calrig.simulator.scheduler import Scheduler, Waits

T = TypeVar("T")


class VirtualClock(Scheduler):
    """A clock of `calrig.instruments.clock`, for all threads that live by it."""

    def sleep(self, duration_s: float) -> None:
        """Waits."""
        self.rest(self.register([], duration_s))

    def condition(self) -> VirtualCondition:
        """To wait for one another."""
        return VirtualCondition(self)

    def event(self) -> VirtualEvent:
        """To wait for what happens once."""
        return VirtualEvent(self)

    def thread(self, target: Callable[[], object], name: str) -> VirtualThread:
        """A daemon thread, not started yet."""
        return VirtualThread(self, target, name)

    def until(self, look: Callable[[], T | None], what: str, within_s: float = 600.0) -> T:
        """Lets time run to the first instant at which there is something to see, and returns that.

        Called by a member, or within `taking_part`, it leaves time standing there.

        Raises:
            AssertionError: nothing was seen within that time.
        """
        give_up_s = self.now_s() + within_s
        with self.taking_part():
            while not (found := look()):
                if self.now_s() > give_up_s:
                    raise AssertionError(f"no {what} within {within_s:g} s")
                self.next_instant()
        return found


class VirtualCondition:
    """As `threading.Condition`, its time-outs counted by the clock."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._waits: Waits = []

    def __enter__(self) -> VirtualCondition:
        self._lock.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def wait_for(self, predicate: Callable[[], T], timeout: float | None = None) -> T:
        """Waits until the predicate holds, or for so many seconds."""
        deadline_s = None if timeout is None else self._clock.now_s() + timeout
        while not (result := predicate()):
            left_s = None if deadline_s is None else deadline_s - self._clock.now_s()
            if left_s is not None and left_s <= 0:
                break
            wait = self._clock.register(self._waits, left_s)
            self._lock.release()
            self._clock.rest(wait)
            self._lock.acquire()
        return result

    def notify_all(self) -> None:
        """Has all who wait look again."""
        self._clock.end(self._waits)


class VirtualEvent:
    """As `threading.Event`, its time-outs counted by the clock."""

    def __init__(self, clock: VirtualClock) -> None:
        self._condition = VirtualCondition(clock)
        self._clock = clock
        self._is_set = False

    def is_set(self) -> bool:
        """Whether it has happened."""
        return self._is_set

    def set(self) -> None:
        """It has happened."""
        with self._condition:
            self._is_set = True
            self._condition.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Waits until it has happened, or for so many seconds; returns whether it has."""
        with self._condition:
            return self._condition.wait_for(lambda: self._is_set, timeout)


class VirtualThread(threading.Thread):
    """A member from its first moment to its last."""

    def __init__(self, clock: VirtualClock, target: Callable[[], object], name: str) -> None:
        super().__init__(name=name, daemon=True)
        self._clock = clock
        self._work = target
        self._in_line = threading.Event()
        self._end = clock.event()

    def start(self) -> None:
        """Begins it: it is in line when this returns."""
        super().start()
        self._in_line.wait()

    def run(self) -> None:
        """Does its work."""
        self._clock.take_part(self._in_line.set)
        try:
            self._work()
        finally:
            self._end.set()
            self._clock.leave_for_good()

    def join(self, timeout: float | None = None) -> None:
        """Waits until its work is done, or for so many seconds."""
        self._end.wait(timeout)
