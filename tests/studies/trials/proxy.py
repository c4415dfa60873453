"""A serial line between calrig and a device that can be damaged: two ends, and what is done to the bytes."""

from __future__ import annotations

import heapq
import os
import pty
import random
import select
import threading
import time
import tty
from collections import Counter
from collections.abc import Callable
from itertools import count
from pathlib import Path

from .proxy_damage import TO_DEVICE, TO_HOST, Damage

READ_SIZE = 65536
TICK_S = 0.5


class Proxy:
    """Stands between calrig and one device, a pseudo-terminal whose name is a link, as in /dev/serial/by-id.

    Attributes:
        port: what calrig opens: the link.
        sent: what calrig wrote, each piece with its time (monotonic).
        done: how often the line was damaged, by direction.
        first_s: when it was first damaged (monotonic), None before.
    """

    def __init__(self, device_url: str, link: Path, damage: Damage, seed: int) -> None:
        self.port = str(link)
        self.sent: list[tuple[float, bytes]] = []
        self.done: Counter[str] = Counter()
        self.first_s: float | None = None
        self._link = link
        self._damage = damage
        self._random = random.Random(seed)
        self._device = os.open(device_url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._near, self._far = _new_terminal()
        self._is_up = True
        self._name()
        self._ear, self._mouth = os.pipe()
        self._stopping = False
        self._late: list[bytes] = []
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._free_s = dict.fromkeys((TO_DEVICE, TO_HOST), 0.0)
        self._waiting = {TO_DEVICE: b"", TO_HOST: b""}
        self._thread = threading.Thread(target=self._serve, name=f"proxy {link.name}", daemon=True)
        self._thread.start()

    @property
    def quiet(self) -> bool:
        """Whether nothing is on its way to the device any more."""
        return not self._waiting[TO_DEVICE] and time.monotonic() >= self._free_s[TO_DEVICE]

    def stop(self) -> None:
        """Ends the line."""
        self._stopping = True
        os.write(self._mouth, b"!")
        self._thread.join()
        if self._is_up:
            self._close_near()
        for fd in (self._device, self._ear, self._mouth):
            os.close(fd)

    def deliver(self, direction: str, data: bytes, after_s: float = 0.0) -> None:
        """Hands bytes over after what was handed over before them; holds back what comes after them."""
        at_s = max(self._free_s[direction], time.monotonic() + after_s)
        self._free_s[direction] = at_s
        self.later(at_s, lambda: self._hand_over(direction, data))

    def keep_for_later(self, data: bytes) -> None:
        """Holds an answer back until calrig has sent its next command."""
        self._late.append(data)

    def later(self, at_s: float, act: Callable[[], None]) -> None:
        """Has the line's own thread do something at a time (monotonic)."""
        heapq.heappush(self._due, (at_s, next(self._order), act))

    def note(self, direction: str) -> None:
        """The line was damaged just now."""
        self.done[direction] += 1
        if self.first_s is None:
            self.first_s = time.monotonic()

    def hang_up(self, back_after_s: float | None, *, under_its_name: bool = True) -> None:
        """The adapter is pulled out; it comes back as another terminal, which the link names or does not."""
        spare = _new_terminal()  # before the old one goes, so that it cannot get the same name
        self._close_near()
        if back_after_s is None:
            for fd in spare:
                os.close(fd)
            return
        self.later(time.monotonic() + back_after_s, lambda: self._come_back(spare, under_its_name))

    def _come_back(self, terminal: tuple[int, int], under_its_name: bool) -> None:
        (self._near, self._far), self._is_up = terminal, True
        if under_its_name:
            self._name()

    def _name(self) -> None:
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(self._far))

    def _close_near(self) -> None:
        self._is_up = False
        self._link.unlink(missing_ok=True)
        self._waiting[TO_HOST] = b""
        os.close(self._near)
        os.close(self._far)

    def _serve(self) -> None:
        while not self._stopping:
            reads = [self._ear, self._device] + [self._near] * self._is_up
            writes = [self._device] * bool(self._waiting[TO_DEVICE])
            writes += [self._near] * (self._is_up and bool(self._waiting[TO_HOST]))
            wait_s = TICK_S if not self._due else max(0.0, self._due[0][0] - time.monotonic())
            readable, writable, _ = select.select(reads, writes, [], min(wait_s, TICK_S))
            if self._is_up and self._near in readable:
                self._hear_host()
            if self._device in readable and (data := _read(self._device)):
                self._damage.piece(self, TO_HOST, data, self._random)
            while self._due and self._due[0][0] <= time.monotonic():
                heapq.heappop(self._due)[2]()
            if self._device in writable:
                self._write(self._device, TO_DEVICE)
            if self._is_up and self._near in writable:
                self._write(self._near, TO_HOST)

    def _hear_host(self) -> None:
        data = _read(self._near)
        self.sent.append((time.monotonic(), data))
        self._damage.piece(self, TO_DEVICE, data, self._random)
        late, self._late = self._late, []
        for answer in late:
            self.deliver(TO_HOST, answer, 0.02)

    def _hand_over(self, direction: str, data: bytes) -> None:
        if direction == TO_DEVICE or self._is_up:  # nobody is there to hear it
            self._waiting[direction] += data
            self._write(self._near if direction == TO_HOST else self._device, direction)

    def _write(self, fd: int, direction: str) -> None:
        try:
            self._waiting[direction] = self._waiting[direction][os.write(fd, self._waiting[direction]) :]
        except BlockingIOError:
            return  # the reader does not keep up


def _new_terminal() -> tuple[int, int]:
    near, far = pty.openpty()
    tty.setraw(far)
    os.set_blocking(near, False)
    return near, far


def _read(fd: int) -> bytes:
    try:
        return os.read(fd, READ_SIZE)
    except BlockingIOError:
        return b""
