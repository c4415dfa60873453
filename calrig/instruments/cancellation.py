"""Cancellation of what a thread does with its devices, checked before each exchange with one.

So identification, homing and every wait for a silent device end soon after a run was stopped. No exchange is
left half done: a reply still on its way would be taken for the next one's. The store checks as well while a
run's write waits for another program's lock.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_check: ContextVar[Callable[[], None] | None] = ContextVar("wanted", default=None)


@contextmanager
def cancel_scope(check: Callable[[], None]) -> Iterator[None]:
    """End what this thread does with devices inside the block with what `check` raises."""
    token = _check.set(check)
    try:
        yield
    finally:
        _check.reset(token)


def raise_if_cancelled() -> None:
    """Raise if the operation was cancelled. Drivers call this before every exchange and every retry."""
    check = _check.get()
    if check is not None:
        check()


def deadline(duration_s: float, late: Exception) -> Callable[[], None]:
    """Return a check that raises `late` after so many seconds of wall time."""
    give_up_s = time.monotonic() + duration_s

    def check() -> None:
        if time.monotonic() > give_up_s:
            raise late

    return check
