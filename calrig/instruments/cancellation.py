"""Whether what a thread does with its devices is still wanted: asked before each exchange with one.

So identification, homing and every wait for a device that does not answer end soon after somebody stopped
the run, and no exchange is left half done: an answer still on its way would be taken for the next one's.
The store asks as well, while what a run has to write waits for another program's lock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_check: ContextVar[Callable[[], None] | None] = ContextVar("wanted", default=None)


@contextmanager
def cancel_scope(check: Callable[[], None]) -> Iterator[None]:
    """What this thread does with devices meanwhile ends with whatever `check` raises."""
    token = _check.set(check)
    try:
        yield
    finally:
        _check.reset(token)


def raise_if_cancelled() -> None:
    """Raises what the check raises; drivers call it before they ask, and whenever they ask again."""
    check = _check.get()
    if check is not None:
        check()


def deadline(duration_s: float, late: Exception) -> Callable[[], None]:
    """A check that raises `late` once so many seconds of the wall's have gone by."""
    give_up_s = time.monotonic() + duration_s

    def check() -> None:
        if time.monotonic() > give_up_s:
            raise late

    return check
