"""Processor time and memory of this process and of those that it started."""

from __future__ import annotations

import resource
import threading

import psutil


def processor_s() -> float:
    """Of this process and of those that it started and that have ended."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


class Memory:
    """Looks every tenth of a second at what this process and those that it started hold.

    Attributes:
        held_mb: what they held, oldest first.
    """

    def __enter__(self) -> Memory:
        self.held_mb: list[float] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    @property
    def most_mb(self) -> float:
        """The most that they held at once."""
        return max(self.held_mb, default=0.0)

    def _look(self) -> None:
        own = psutil.Process()
        while not self._ended.wait(0.1):
            held = 0
            for process in (own, *own.children(recursive=True)):
                try:
                    held += process.memory_info().rss
                except psutil.NoSuchProcess:
                    continue
            self.held_mb.append(held / 1e6)
