"""A sign in the stream of a `calrig` board that what comes after it was measured after it was asked for.

The sign is the answer to `ID`, which the board gives between two samples. However long samples are held up
on their way, those behind the sign are new; a clock compared with the host's could not tell where the rig's
run faster. Answers do not say which asking they answer, so as many have to come as were asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable

ASK_AGAIN_S = 0.5
ATTEMPTS = 3
LOST_S = 5.0
"""An answer that has not come by then will not."""


class Mark:
    """The sign that was asked for last.

    Args:
        ask: asks for one.
        now_s: the port's clock.
    """

    def __init__(self, ask: Callable[[], None], now_s: Callable[[], float]) -> None:
        self._ask_board = ask
        self._now_s = now_s
        self._asked = self._heard = self._wanted = 0
        self._tries = 0
        self._asked_s = -math.inf
        self._gives_none = False

    def begin(self) -> None:
        """Asks for a sign."""
        if self._now_s() - self._asked_s > LOST_S:
            self._heard = self._asked
        self._wanted, self._tries = self._asked + 1, 0
        self._ask()

    def came(self) -> bool:
        """Whether it has come; where not, it is asked for again. A board that never gave one is given up."""
        if self._gives_none or self._heard >= self._wanted:
            return True
        if self._now_s() - self._asked_s > ASK_AGAIN_S:
            if self._tries >= ATTEMPTS and self._heard == 0:
                self._gives_none = True
            else:
                self._ask()
        return self._gives_none

    def heard(self) -> bool:
        """An identity came while the board streamed: whether it may be an answer, and no reset."""
        if self._heard >= self._asked:
            return False
        self._heard += 1
        return True

    def _ask(self) -> None:
        if not self._gives_none:
            self._asked += 1
            self._tries += 1
            self._asked_s = self._now_s()
            self._ask_board()
