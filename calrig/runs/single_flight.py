"""Run at most one task per key at a time, each in its own thread; concurrent callers share its result."""

import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from functools import partial
from typing import Generic, TypeVar

from calrig.instruments.clock import Clock

T = TypeVar("T")


class SharedTask(Generic[T]):
    """Work under way. `future` is for who waits in an event loop, `result` for who waits by the clock."""

    def __init__(self, clock: Clock) -> None:
        self.future: Future[T] = Future()
        self._over = clock.event()

    def result(self) -> T:
        """What came of it, or what it raised."""
        self._over.wait()
        return self.future.result()

    def carry_out(self, work: Callable[[], T]) -> None:
        """Does the work; what it raises is for those who asked."""
        try:
            done = work()
        except Exception as error:  # noqa: BLE001 (it is raised again for those who asked)
            self.future.set_exception(error)
        else:
            self.future.set_result(done)
        finally:
            self._over.set()


class SingleFlight:
    """Errands by key: one thread for each, however many ask. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._under_way: dict[Hashable, SharedTask[object]] = {}

    def share(self, key: Hashable, clock: Clock, work: Callable[[], T]) -> SharedTask[T]:
        """The errand of this key that is under way, or else a new one; waits for nothing.

        The thread of `clock` does it.
        """
        with self._lock:
            errand = self._under_way.get(key)
            if errand is None:
                errand = self._under_way[key] = SharedTask(clock)
                carry_out = partial(errand.carry_out, partial(self._work_to_its_end, key, work))
                clock.thread(carry_out, f"errand {key}").start()
            return errand  # type: ignore[return-value]  # of the same key, so of the same work

    def _work_to_its_end(self, key: Hashable, work: Callable[[], T]) -> T:
        try:
            return work()
        finally:
            with self._lock:  # before anybody hears of its end: who asks from then on asks anew
                del self._under_way[key]
