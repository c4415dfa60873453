"""How often an address may try a code: what is tried wrongly is forgotten a minute later."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from calrig.api.access import network_of
from calrig.api.callers import address_of

MOST_EACH = 5
MOST_ALL = 100
"""Wrong ones within FORGOTTEN_S, from one address and from all: the memory is that of so many."""
FORGOTTEN_S = 60.0


class Attempts:
    """Wrong attempts of the last minute, by address.

    Args:
        clock: tells the time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._turn = threading.Lock()
        self._wrong: list[tuple[float, str]] = []

    def begin(self, asked: HTTPConnection) -> tuple[float, str]:
        """Counts an attempt as wrong until it is `right`: those that come at once are each counted.

        Raises:
            HTTPException: 429, too many wrong ones came within the last minute.
        """
        address, now_s = address_of(asked), self._clock()
        network = network_of(address) or address
        with self._turn:
            self._wrong = [one for one in self._wrong if now_s - one[0] < FORGOTTEN_S]
            from_there = sum(one[1] == network for one in self._wrong)
            if from_there >= MOST_EACH or len(self._wrong) >= MOST_ALL:
                reason = f"too many wrong codes from {address}: try again in a minute"
                raise HTTPException(429, reason, {"Retry-After": f"{FORGOTTEN_S:.0f}"})
            self._wrong.append((now_s, network))
        return now_s, network

    def right(self, attempt: tuple[float, str]) -> None:
        """Takes back that an attempt was counted."""
        with self._turn:
            if attempt in self._wrong:
                self._wrong.remove(attempt)
