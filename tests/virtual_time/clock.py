"""Virtual time: a clock that is the discrete-event scheduler of the threads that live by it.

The threads (its members) run one at a time, in the order in which what they waited for happened, each until
it waits again. When all of them wait, time goes to the next instant at which a member continues or a device
has something to send. So a run has the same result however busy the machine is, and takes no longer than
what is computed in it.

A thread is a member while it takes part: time stands while such a thread does something else. No member may
hold a lock that another one needs while it waits. Any other thread is a visitor: it may act, and wait for
members, at any moment. A thread that the clock makes is a member.
"""

from __future__ import annotations

import heapq
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from typing import TypeVar

T = TypeVar("T")
BEGINNING_S = 1000.0
"""Not 0, so that a time of long ago is not taken for now."""
SHORTEST_REST_S = 0.002
LOOK_S = 0.02
"""How far off `next_instant` is at most, where nothing happens but motion."""


class Wait:
    """One thread's wait; over once what it waited for has happened, or its time has come."""

    __slots__ = ("_gate", "ident", "is_member", "is_over", "timed_out")

    def __init__(self, ident: int, *, is_member: bool) -> None:
        self.ident = ident
        self.is_member = is_member
        self.is_over = self.timed_out = False
        self._gate = threading.Lock()
        self._gate.acquire()

    def rest(self) -> None:
        """Until this thread may go on."""
        self._gate.acquire()

    def go_on(self) -> None:
        """Ends `rest`."""
        self._gate.release()


Waits = list[Wait]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One reason for which a thread is a member, of however many."""

    ident: int


class VirtualClock:
    """A clock of `calrig.instruments.clock`, for all threads that live by it: time moves on when all wait.

    At most `most_speed` seconds pass for one of the wall's while no visitor waits; None for as many as can be
    computed.

    Attributes:
        lock: guards what happens at an instant.
    """

    def __init__(self, most_speed: float | None = None) -> None:
        self.lock = threading.RLock()
        self._now_s = BEGINNING_S
        self._members: dict[int, set[Part]] = {}
        self._turn: int | None = None
        self._ready: deque[Wait] = deque()
        self._timers: list[tuple[float, int, Wait | None, Callable[[], None]]] = []
        self._order = count()
        self._n_waiting = self._n_visitors = self._n_instants = 0
        self._watchers: deque[tuple[int, Wait]] = deque()
        self._dispatching = self._stopped = False
        self._most_speed = most_speed
        self._pace = threading.Condition(self.lock)
        self._paced_since = (time.monotonic(), self._now_s)

    def now_s(self) -> float:
        """The instant."""
        return self._now_s

    def at(self, at_s: float, act: Callable[[], None]) -> None:
        """Has something happen at an instant: called with the lock held, on no thread in particular."""
        with self.lock:
            heapq.heappush(self._timers, (at_s, next(self._order), None, act))

    def stop(self) -> None:
        """Stop time from here on."""
        with self.lock:
            self._stopped = True

    @contextmanager
    def taking_part(self) -> Iterator[None]:
        """Make the calling thread a member inside the block, which begins when it is its turn."""
        me = self.take_part()
        try:
            yield
        finally:
            self.leave(me)

    @contextmanager
    def standing_aside(self) -> Iterator[None]:
        """Make the calling member a visitor inside the block, to wait for members without the clock."""
        me = threading.get_ident()
        with self.lock:
            parts = self._members.pop(me)
            self._turn = None
            self._dispatch()
        try:
            yield
        finally:
            self.take_part()
            self._members[me] = parts

    def take_part(self, announce: Callable[[], None] = lambda: None) -> Part:
        """As `taking_part`; `leave`, called with what this returns, ends it. Tells when it is in line."""
        part = Part(threading.get_ident())
        with self.lock:
            parts = self._members.setdefault(part.ident, set())
            parts.add(part)
            if len(parts) > 1:
                return part
            wait = self._begin_wait(None)
            self._end(wait)
            self._dispatch()
        announce()
        wait.rest()
        return part

    def leave(self, part: Part) -> None:
        """Ends what `take_part` began, unless its thread has ended since."""
        with self.lock:
            parts = self._members.get(part.ident, set())
            parts.discard(part)
            if not parts and part.ident in self._members:
                self._is_gone(part.ident)

    def leave_for_good(self) -> None:
        """The calling thread ends: a port that it has opened and somebody else uses makes it no member."""
        with self.lock:
            self._is_gone(threading.get_ident())

    def _is_gone(self, ident: int) -> None:
        del self._members[ident]
        if self._turn == ident:
            self._turn = None
        self._dispatch()

    def register(self, among: Waits, timeout_s: float | None) -> Wait:
        """Begin a wait of the calling thread, listed for the thread that ends it; `rest` must follow."""
        with self.lock:
            among[:] = [other for other in among if not other.is_over]  # of those that timed out
            wait = self._begin_wait(timeout_s)
            among.append(wait)
            return wait

    def rest(self, wait: Wait) -> bool:
        """Until the wait is over; returns whether that was before its time."""
        with self.lock:
            if wait.is_member:
                self._turn = None
            self._dispatch()
        wait.rest()
        return not wait.timed_out

    def end(self, waits: Waits) -> None:
        """What they waited for has happened."""
        with self.lock:
            for wait in waits:
                self._end(wait)
            waits.clear()
            self._dispatch()

    def next_instant(self) -> None:
        """Waits until all members have done what the next instant has for them; it is not far off."""
        with self.lock:
            wait = self._begin_wait(LOOK_S)
            self._watchers.append((self._n_instants, wait))
        self.rest(wait)

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

    def _begin_wait(self, timeout_s: float | None) -> Wait:
        me = threading.get_ident()
        wait = Wait(me, is_member=me in self._members)
        self._n_waiting += 1
        self._n_visitors += not wait.is_member
        if timeout_s is not None:
            at_s = self._now_s + max(0.0, timeout_s)
            act = lambda: self._end(wait, timed_out=True)  # noqa: E731
            heapq.heappush(self._timers, (at_s, next(self._order), wait, act))
        return wait

    def _end(self, wait: Wait, *, timed_out: bool = False) -> None:
        if wait.is_over:
            return
        wait.is_over, wait.timed_out = True, timed_out
        self._n_waiting -= 1
        self._n_visitors -= not wait.is_member
        if wait.is_member:
            self._ready.append(wait)
        else:
            wait.go_on()

    def _dispatch(self) -> None:
        """Give the turn to a thread that is ready, moving time on until one is. The lock is held."""
        if self._dispatching:
            return self._pace.notify_all()
        self._dispatching = True
        try:
            while self._turn is None and not self._stopped:
                if self._ready:
                    wait = self._ready.popleft()
                    self._turn = wait.ident
                    wait.go_on()
                elif self._watchers and self._watchers[0][0] < self._n_instants:
                    self._end(self._watchers.popleft()[1])
                elif not self._advance():
                    break
        finally:
            self._dispatching = False

    def _advance(self) -> bool:
        """Goes to the next instant, or rests where that would be too fast; False where there is none."""
        timers = self._timers
        while timers and timers[0][2] is not None and timers[0][2].is_over:
            heapq.heappop(timers)
        if not timers or not self._n_waiting:
            return False
        at_s = timers[0][0]
        if (rest_s := self._rest_s(at_s)) > SHORTEST_REST_S:
            self._pace.wait(rest_s)
            return True
        self._now_s = max(self._now_s, at_s)
        self._n_instants += 1
        while timers and timers[0][0] <= self._now_s:
            heapq.heappop(timers)[3]()
        return True

    def _rest_s(self, at_s: float) -> float:
        """How long to rest, of the wall's time, before an instant may come."""
        if self._most_speed is None:
            return 0.0
        wall_s, since_s = self._paced_since
        ahead_s = (at_s - since_s) / self._most_speed - (time.monotonic() - wall_s)
        if self._n_visitors or self._watchers or ahead_s < 0.0:
            self._paced_since = time.monotonic(), at_s
            return 0.0
        return ahead_s


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
