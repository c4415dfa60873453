"""Who carries the pieces of a re-analysis out: processes of this machine, or whoever else takes them."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from calrig.processes.pool import Processes

T = TypeVar("T")
K = TypeVar("K")
AHEAD = 2
"""Questions to a worker that are ready when it has answered; more would only fill memory."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Those that are there: `slots` carry something out at once."""

    submit: Callable[[Callable[[], Any]], Future[Any]]
    slots: int
    what: str

    def answers(self, questions: Iterable[tuple[K, Callable[[], T]]]) -> Iterator[tuple[K, T | Exception]]:
        """What each question gave, or raised, in the order answered; as many are asked as keep all busy."""
        asked: dict[Future[T], K] = {}
        for key, question in questions:
            asked[self.submit(question)] = key
            while len(asked) >= AHEAD * self.slots:
                yield from _done(asked)
        while asked:
            yield from _done(asked)


def _done(asked: dict[Future[T], K]) -> Iterator[tuple[K, T | Exception]]:
    finished, _ = wait(asked, return_when=FIRST_COMPLETED)
    for future in finished:
        key, error = asked.pop(future), future.exception()
        if error is not None and not isinstance(error, Exception):
            raise error
        yield key, future.result() if error is None else error


@contextmanager
def own_processes(slots: int | None = None) -> Iterator[Workers]:
    """Processes of calrig's own, without a number one a core; each piece has a bound of time and memory."""
    slots = slots or len(os.sched_getaffinity(0))
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="fleet", daemon=True)
    thread.start()
    processes = Processes(slots)
    try:
        yield Workers(
            lambda question: asyncio.run_coroutine_threadsafe(processes.run(question), loop),
            slots,
            f"{slots} processes",
        )
    finally:
        asyncio.run_coroutine_threadsafe(_end(processes), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


async def _end(processes: Processes) -> None:
    """Gives up what is in hand, and ends the processes."""
    pieces = asyncio.all_tasks() - {asyncio.current_task()}
    for piece in pieces:
        piece.cancel()
    await asyncio.gather(*pieces, return_exceptions=True)
    await processes.close()
