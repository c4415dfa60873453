"""The thread that reads a board: whatever ends it is told to whoever waits for the board."""

from __future__ import annotations

import logging
from collections.abc import Callable

from calrig.instruments.errors import BoardError, InstrumentError

log = logging.getLogger(__name__)


def reader(
    listen: Callable[[], None], fail: Callable[[InstrumentError], None], name: str
) -> Callable[[], None]:
    """The work of such a thread.

    Args:
        listen: reads until the board is closed.
        fail: is told why it ended before, be it by a defect of calrig's own.
        name: of the board.
    """

    def read() -> None:
        try:
            listen()
        except InstrumentError as error:
            fail(error)
        except Exception as error:
            log.exception("the reader of %s failed", name)
            kind = type(error).__name__
            fail(BoardError(f"{name}: reading it failed inside calrig ({kind}: {error}); see the log"))

    return read
