"""Processes for heavy work that the services of a test worker share.

To start one that loads numpy and scipy takes half a second of processor time. A service in use has its own
for as long as it lives; one in a test lives for a few requests.
"""

from __future__ import annotations

import asyncio
import atexit
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from calrig.processes.pool import Processes

if TYPE_CHECKING:
    from calrig.analysis.fleet import Workers

T = TypeVar("T")


class SharedProcesses(Processes):
    """Processes in an event loop of their own, asked from the loops of services, which leave them open."""

    def __init__(self) -> None:
        super().__init__()
        self._loop = asyncio.new_event_loop()
        # A daemon: Python waits for other threads before it calls what ends this one.
        threading.Thread(target=self._loop.run_forever, name="shared processes", daemon=True).start()
        atexit.register(self._end)

    async def run(
        self,
        function: Callable[..., T],
        *,
        user: str = "",
        longest_s: float | None = None,
        begun: Callable[[], None] = lambda: None,
        progress: Callable[[float], None] | None = None,
    ) -> T:
        """As its own, heard in the loop of who asks."""
        here, over = asyncio.get_running_loop(), asyncio.Event()
        tasks: list[asyncio.Task[T]] = []

        def heard(call: Callable[..., None]) -> Callable[..., None]:
            return lambda *told: (here.call_soon_threadsafe(call, *told), None)[1]

        work = super().run(
            function,
            user=user,
            longest_s=longest_s,
            begun=heard(begun),
            progress=progress and heard(progress),
        )

        def begin() -> None:
            tasks.append(self._loop.create_task(work))
            tasks[0].add_done_callback(heard(lambda _: over.set()))

        self._loop.call_soon_threadsafe(begin)
        try:
            await over.wait()
        except asyncio.CancelledError:
            self._loop.call_soon_threadsafe(lambda: tasks[0].cancel())  # noqa: PLW0108 (it may yet begin)
            await over.wait()
            raise
        return tasks[0].result()

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Begins a piece for a thread that waits for several."""
        return asyncio.run_coroutine_threadsafe(super().run(function), self._loop)

    async def close(self) -> None:
        """Leaves them to the next service."""

    def _end(self) -> None:
        asyncio.run_coroutine_threadsafe(super().close(), self._loop).result()


@cache
def shared_processes() -> SharedProcesses:
    """Those of this test worker or trial: they end with it."""
    return SharedProcesses()


@contextmanager
def shared_workers() -> Iterator[Workers]:
    """As `calrig.analysis.fleet.own_processes`, by those that are there already."""
    from calrig.analysis.fleet import Workers

    shared = shared_processes()
    yield Workers(shared.submit, shared.slots, f"{shared.slots} processes")


def in_shared_process(function: Callable[[], T]) -> T:
    """As `calrig.processes.pool.run_in_subprocess`, in a process that is there already."""
    return asyncio.run(shared_processes().run(function))
