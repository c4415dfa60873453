"""A line that can be damaged, as `proxy` has it, to a simulated device in virtual time."""

from __future__ import annotations

import random
from collections import Counter

from virtual_time.clock import VirtualClock
from virtual_time.world import SimWire

from calrig.simulator.wire import Device

from .proxy_damage import TO_DEVICE, TO_HOST, Damage

ANSWERED_S = 0.02


class VirtualProxy(SimWire):
    """The wire of a device, from `start` until `stop`; its attributes are those of `proxy.Proxy`."""

    def __init__(self, device: Device, name: str, clock: VirtualClock, damage: Damage, seed: int) -> None:
        super().__init__(device, name, clock)
        self.sent: list[tuple[float, bytes]] = []
        self.done: Counter[str] = Counter()
        self.first_s: float | None = None
        self._damage = damage
        self._random = random.Random(seed)
        self._late: list[bytes] = []
        self._free_s = dict.fromkeys((TO_DEVICE, TO_HOST), 0.0)
        self._on_its_way = 0

    @property
    def port(self) -> str:
        """What calrig opens."""
        return self.url

    @property
    def quiet(self) -> bool:
        """Whether nothing is on its way to the device any more."""
        return not self._on_its_way

    def hear(self, data: bytes) -> None:
        """What calrig wrote, damaged or not."""
        self.sent.append((self.clock.now_s(), data))
        self._damage.piece(self, TO_DEVICE, data, self._random)
        late, self._late = self._late, []
        for answer in late:
            self.deliver(TO_HOST, answer, ANSWERED_S)

    def say(self, data: bytes) -> None:
        """What the device says, damaged or not."""
        if data:
            self._damage.piece(self, TO_HOST, data, self._random)

    def deliver(self, direction: str, data: bytes, after_s: float = 0.0) -> None:
        """Hands bytes over after what was handed over before them; holds back what comes after them."""
        at_s = max(self._free_s[direction], self.clock.now_s() + after_s)
        self._free_s[direction] = at_s
        if direction == TO_HOST:
            self.clock.at(at_s, lambda: super(VirtualProxy, self).say(data))
        else:
            self._on_its_way += 1
            self.clock.at(at_s, lambda: self._arrive(data))

    def keep_for_later(self, data: bytes) -> None:
        """Holds an answer back until calrig has sent its next command."""
        self._late.append(data)

    def note(self, direction: str) -> None:
        """The line was damaged just now."""
        self.done[direction] += 1
        if self.first_s is None:
            self.first_s = self.clock.now_s()

    def hang_up(self, back_after_s: float | None, *, under_its_name: bool = True) -> None:
        """The adapter is pulled out; it comes back under its name, or under one that nobody knows."""
        self.stop()
        if back_after_s is not None and under_its_name:
            self.clock.at(self.clock.now_s() + back_after_s, self.start)

    def _arrive(self, data: bytes) -> None:
        self._on_its_way -= 1
        super().hear(data)
