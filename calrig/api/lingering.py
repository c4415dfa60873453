"""A connection that is closed before its client has sent all it meant to: the client gets its answer whole.

Closed at once, what comes afterwards would be met with a reset, which takes an answer that has not been read
out of the client's hands.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

CLOSE = {"Connection": "close"}
"""Headers of an answer after which the connection is closed: who is refused does not keep it."""
LINGER_S = 10.0
"""How long what still comes is taken and dropped, once no more will be sent."""


class LingeringTransport(asyncio.Transport):
    """A transport whose `close` waits for the client where more is to come from it.

    Args:
        transport: what it closes in the end.
        expects_more: whether the client is in the midst of a request.
    """

    def __init__(self, transport: asyncio.Transport, expects_more: Callable[[], bool]) -> None:
        super().__init__()
        self._transport = transport
        self._expects_more = expects_more
        self._end: asyncio.TimerHandle | None = None

    @property
    def lingers(self) -> bool:
        """Whether what comes is to be dropped."""
        return self._end is not None

    @property
    def is_gone(self) -> bool:
        """Whether nothing is waited for any more, neither to come nor to be taken."""
        return self._transport.is_closing() and not self._transport.get_write_buffer_size()

    def close(self) -> None:
        """Sends what is still to be sent, and no more; then waits for the client's end, for a while."""
        if self._end is not None or self._transport.is_closing():
            return
        if not self._expects_more():
            self._transport.close()
            return
        self._end = asyncio.get_running_loop().call_later(LINGER_S, self._transport.abort)
        self._transport.resume_reading()
        self._transport.write_eof()

    def abort(self) -> None:
        """Closes at once; what was not sent is lost."""
        self._transport.abort()

    def lost(self) -> None:
        """Forgets the clock."""
        if self._end is not None:
            self._end.cancel()

    def is_closing(self) -> bool:
        """Whether nothing more can be sent."""
        return self.lingers or self._transport.is_closing()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """As the transport's."""
        if not self.lingers:
            self._transport.write(data)

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """As the transport's."""
        return self._transport.get_extra_info(name, default)

    def get_write_buffer_size(self) -> int:
        """As the transport's."""
        return self._transport.get_write_buffer_size()

    def pause_reading(self) -> None:
        """As the transport's."""
        self._transport.pause_reading()

    def resume_reading(self) -> None:
        """As the transport's."""
        self._transport.resume_reading()
