"""People who have logged in on the page."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass

SESSION_S = 12 * 3600.0
MOST_SESSIONS = 100


@dataclass(frozen=True, slots=True)
class _Session:
    ends_s: float
    token_sha256: str


class Sessions:
    """A random value for each session, kept in memory and no longer than a day's work.

    A session says by which token it was begun, and opens what that token opens at the time: it ends with the
    token. The oldest one gives way to one too many; all end with the service.

    Args:
        clock: seconds that only go forward.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # By digest: how long a look-up takes then says nothing about the values that are kept.
        self._kept: dict[bytes, _Session] = {}

    def begin(self, token_sha256: str) -> str:
        """A new session's value."""
        now_s = self._clock()
        self._kept = {value: kept for value, kept in self._kept.items() if kept.ends_s > now_s}
        while len(self._kept) >= MOST_SESSIONS:
            del self._kept[next(iter(self._kept))]
        value = secrets.token_urlsafe(32)
        self._kept[_digest(value)] = _Session(now_s + SESSION_S, token_sha256)
        return value

    def token_of(self, value: str) -> str | None:
        """Digest of the token that a session was begun with; None where there is none, or it has ended."""
        kept = self._kept.get(_digest(value))
        return kept.token_sha256 if kept is not None and kept.ends_s > self._clock() else None

    def end(self, value: str) -> None:
        """Ends a session; one that has ended already stays so."""
        self._kept.pop(_digest(value), None)

    def __len__(self) -> int:
        return len(self._kept)


def _digest(value: str) -> bytes:
    return hashlib.sha256(value.encode()).digest()
