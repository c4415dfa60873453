"""How long a bench may act on its centre's orders since the centre last answered, by the bench's own clock.

It only keeps a bench that is cut off from beginning what somebody may have thought better of meanwhile: that
nothing is begun twice rests on the epochs of orders alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

LEASE_S = 15.0


class Lease:
    """Held for `LEASE_S` from before the question that the centre answered last. Thread-safe.

    Args:
        now_s: seconds that never go back.

    Attributes:
        losses: how often it was found lost.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._until_s: float | None = None
        self.losses = 0

    def asked_at_s(self) -> float:
        """The time, to be noted before the centre is asked."""
        return self._now_s()

    def renew(self, asked_at_s: float) -> bool:
        """The centre answered what was asked then; returns whether the lease was not held before."""
        was_held = self.is_held()
        with self._lock:
            self._until_s = asked_at_s + LEASE_S
        return not was_held

    def is_held(self) -> bool:
        """Whether orders may be acted on."""
        with self._lock:
            if self._until_s is None:
                return False
            if self._now_s() < self._until_s:
                return True
            self._until_s = None
            self.losses += 1
            return False
