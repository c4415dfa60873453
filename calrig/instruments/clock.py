"""The time that devices live in. It comes with their port: the wall's, unless the port brings its own."""

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol


class Condition(AbstractContextManager[object], Protocol):
    """A `threading.Condition` whose time-outs are counted by its clock."""

    def wait_for(self, predicate: Callable[[], object], timeout: float | None = None) -> object:
        """Waits until the predicate holds, or for so many seconds."""

    def notify_all(self) -> None:
        """Has all who wait look again."""


class Event(Protocol):
    """A `threading.Event` whose time-outs are counted by its clock."""

    def is_set(self) -> bool:
        """Whether it has happened."""

    def set(self) -> None:
        """It has happened."""

    def wait(self, timeout: float | None = None) -> bool:
        """Waits until it has happened, or for so many seconds; returns whether it has."""


class Thread(Protocol):
    """A `threading.Thread` that lives by its clock."""

    def start(self) -> None:
        """Begins it."""

    def join(self, timeout: float | None = None) -> None:
        """Waits until it has ended, or for so many seconds of its clock."""


class Clock(Protocol):
    """Seconds that never go back, and all that waits by them.

    Threads that wait for a device, or make others wait for one, are made by its clock: a simulated one moves
    time on when all of them wait.
    """

    def now_s(self) -> float:
        """The time, from any beginning."""

    def sleep(self, duration_s: float) -> None:
        """Waits."""

    def condition(self) -> Condition:
        """To wait for one another."""

    def event(self) -> Event:
        """To wait for what happens once."""

    def thread(self, target: Callable[[], object], name: str) -> Thread:
        """A daemon thread, not started yet."""


class WallClock:
    """The time of this machine."""

    def now_s(self) -> float:
        """Monotonic seconds."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        """Waits."""
        time.sleep(duration_s)

    def condition(self) -> Condition:
        """As `threading` has it."""
        return threading.Condition()

    def event(self) -> Event:
        """As `threading` has it."""
        return threading.Event()

    def thread(self, target: Callable[[], object], name: str) -> Thread:
        """A daemon thread, not started yet."""
        return threading.Thread(target=target, name=name, daemon=True)


WALL = WallClock()
