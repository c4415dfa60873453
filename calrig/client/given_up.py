"""Whether anybody still wants what a thread is waiting for: asyncio cannot interrupt it."""

from __future__ import annotations

import threading
from contextvars import ContextVar

GIVEN_UP: ContextVar[threading.Event | None] = ContextVar("given_up", default=None)
"""Set by `AsyncClient` where its caller was cancelled."""


class GivenUp(BaseException):
    """Ends the thread's work as Ctrl-C would; nobody hears of it."""


def nap(seconds: float = 0.0) -> None:
    """Waits for a while; not at all, it looks whether to go on.

    Raises:
        GivenUp: nobody wants the outcome any more.
    """
    given_up = GIVEN_UP.get() or threading.Event()
    if given_up.wait(seconds):
        raise GivenUp
