"""People who have logged in: a random value each, kept in memory and no longer than a day's work."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Callable

LASTS_S = 12 * 3600.0
AT_MOST = 100


class Sessions:
    """The sessions there are. The oldest gives way to one too many; all end with the service.

    Args:
        clock: seconds that only go forward.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # By digest: how long a look-up takes then says nothing about the values that are kept.
        self._ends_s: dict[bytes, float] = {}

    def begin(self) -> str:
        """A new session's value."""
        now_s = self._clock()
        self._ends_s = {kept: end_s for kept, end_s in self._ends_s.items() if end_s > now_s}
        while len(self._ends_s) >= AT_MOST:
            del self._ends_s[next(iter(self._ends_s))]
        value = secrets.token_urlsafe(32)
        self._ends_s[_digest(value)] = now_s + LASTS_S
        return value

    def holds(self, value: str) -> bool:
        """Whether the value is that of a session which has not ended."""
        return self._ends_s.get(_digest(value), 0.0) > self._clock()

    def end(self, value: str) -> None:
        """Ends a session; one that has ended already stays so."""
        self._ends_s.pop(_digest(value), None)

    def __len__(self) -> int:
        return len(self._ends_s)


def _digest(value: str) -> bytes:
    return hashlib.sha256(value.encode()).digest()
