"""The event streams that are open, so that all of them end when the service does."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager


class Streams:
    """Open streams by the event each of them waits for. Used in the server's event loop only."""

    def __init__(self) -> None:
        self.closed = False
        self._waiting: set[asyncio.Event] = set()

    @contextmanager
    def joined(self, news: asyncio.Event) -> Iterator[None]:
        """Counts a stream as open; `news` is set when the service is closing."""
        self._waiting.add(news)
        try:
            yield
        finally:
            self._waiting.discard(news)

    def __len__(self) -> int:
        return len(self._waiting)

    def close(self) -> None:
        """Has every stream end: a browser that listens must not keep the service from stopping."""
        self.closed = True
        for news in self._waiting:
            news.set()
