"""Who watches the same shares a look into the store; no event stream misses what it was woken for."""

from __future__ import annotations

import asyncio
import threading

import pytest
from support import run_async

from calrig.api.streams import ReadCache, ReadCoalescer
from calrig.store import StoreError


def test_a_look_is_shared_until_it_begins_and_by_nobody_after_that() -> None:
    looks, began, go_on = ReadCoalescer(), threading.Event(), threading.Event()
    n_looks = 0

    def look() -> int:
        nonlocal n_looks
        n_looks += 1
        seen = n_looks
        began.set()
        assert go_on.wait(60)
        return seen

    async def ask() -> tuple[list[int], int]:
        first = [asyncio.create_task(looks.share("run 1", look)) for _ in range(50)]
        await asyncio.to_thread(began.wait, 60)
        later = asyncio.create_task(looks.share("run 1", look))
        go_on.set()
        return await asyncio.gather(*first), await later

    assert run_async(ask()) == ([1] * 50, 2)


class Clock:
    """Time goes on when a test says so."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        return self.time_s


def test_what_a_look_gave_is_good_for_a_while_for_all_who_ask() -> None:
    clock, n_looks = Clock(), 0

    def look() -> int:
        nonlocal n_looks
        n_looks += 1
        return n_looks

    async def ask() -> list[list[int]]:
        lately, seen = ReadCache(clock.now_s), []
        for clock.time_s in (0.0, 0.9, 1.0, 1.9, 2.1):
            seen.append(list(await asyncio.gather(*(lately.share("rigs", look, 1.0) for _ in range(100)))))
        return seen

    assert [set(one) for one in run_async(ask())] == [{1}, {1}, {2}, {2}, {3}]


def test_a_look_that_takes_long_is_good_for_longer_and_one_that_failed_for_nobody_who_comes_later() -> None:
    clock, n_looks = Clock(), 0

    def look() -> int:
        nonlocal n_looks
        n_looks += 1
        if n_looks == 1:
            raise StoreError("the disk is full")
        clock.time_s += 3.0
        return n_looks

    async def ask() -> list[int]:
        lately = ReadCache(clock.now_s)
        with pytest.raises(StoreError):
            await lately.share("overdue", look, 1.0)
        seen = []
        for clock.time_s in (0.0, 29.0, 31.0):
            seen.append(await lately.share("overdue", look, 1.0))
        return seen

    assert run_async(ask()) == [2, 2, 3]
