"""The event streams that are open: woken when their run's log has grown, ended when the service is."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from calrig.api.looks import Looks
from calrig.api.turns import Turns
from calrig.runs.bus import Bus

WRITTEN_IN_A_ROUND = 4
"""Streams written to before the event loop looks what has come: each takes a third of a millisecond."""


@dataclass
class _Watched:
    """A run that somebody watches: the event that each of its streams waits for."""

    news: set[asyncio.Event] = field(default_factory=set)
    leave: Callable[[], None] = lambda: None


class Streams:
    """All event streams of a service, by their run. Used in the server's event loop only.

    `looks` are theirs into the store, `turns` those of writing.
    """

    def __init__(self) -> None:
        self.closed = False
        self.looks = Looks()
        self.turns = Turns(WRITTEN_IN_A_ROUND)
        self._watched: dict[str, _Watched] = {}

    @contextmanager
    def joined(self, bus: Bus, run_id: str) -> Iterator[asyncio.Event]:
        """Counts a stream as open; what is given is set when the run's log has grown or the service ends."""
        watched = self._watched.get(run_id)
        if watched is None:
            watched = self._watched[run_id] = _Watched()
            watched.leave = bus.subscribe(run_id, _waking(watched))
        news = asyncio.Event()
        watched.news.add(news)
        try:
            yield news
        finally:
            watched.news.discard(news)
            if not watched.news:
                watched.leave()
                del self._watched[run_id]

    def __len__(self) -> int:
        return sum(len(watched.news) for watched in list(self._watched.values()))

    def close(self) -> None:
        """Has every stream end: a browser that listens must not keep the service from stopping."""
        self.closed = True
        for watched in self._watched.values():
            _tell(watched)


def _waking(watched: _Watched) -> Callable[[], None]:
    """The call that a run's thread makes: one for all of its streams, not one for each."""
    loop = asyncio.get_running_loop()

    def wake() -> None:
        loop.call_soon_threadsafe(_tell, watched)

    return wake


def _tell(watched: _Watched) -> None:
    for news in watched.news:
        news.set()
