"""A sign in the stream of a `calrig` board that what comes after it was measured after it was asked for.

The sign is the answer to `ID`, which the board gives between two samples. However long samples are held up
on their way, those behind the sign are new; a clock compared with the host's could not tell where the rig's
run faster. Answers do not say which asking they answer, so each counts for the first that may still be
answered.
"""

from __future__ import annotations

from collections import deque
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
        self._open: deque[tuple[int, float]] = deque()  # askings without an answer: number, when
        self._asked = self._heard = self._wanted = 0
        self._tries = 0
        self._gives_none = False

    def begin(self) -> None:
        """Asks for a sign."""
        self._wanted, self._tries = self._asked + 1, 0
        self._ask()

    def came(self) -> bool:
        """Whether it has come; where not, it is asked for again. A board that never gave one is given up."""
        if self._gives_none or self._heard >= self._wanted:
            return True
        if not self._open or self._now_s() - self._open[-1][1] > ASK_AGAIN_S:
            if self._tries >= ATTEMPTS and self._heard == 0:
                self._gives_none = True
            else:
                self._ask()
        return self._gives_none

    def heard(self) -> bool:
        """An identity came while the board streamed: whether it may be an answer, and no reset.

        It may be that to the first asking that is still open: those after it are taken to be on their way.
        """
        self._forget_the_lost()
        if not self._open:
            return False
        self._heard, _ = self._open.popleft()
        return True

    def _ask(self) -> None:
        if not self._gives_none:
            self._forget_the_lost()
            self._asked += 1
            self._tries += 1
            self._open.append((self._asked, self._now_s()))
            self._ask_board()

    def _forget_the_lost(self) -> None:
        while self._open and self._now_s() - self._open[0][1] > LOST_S:
            self._open.popleft()
