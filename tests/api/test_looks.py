"""Event streams that have come equally far share a look into the store; none misses what it was woken for."""

from __future__ import annotations

import asyncio
import threading

from support import run_async

from calrig.api.looks import Looks


def test_a_look_is_shared_until_it_begins_and_by_nobody_after_that() -> None:
    looks, began, go_on = Looks(), threading.Event(), threading.Event()
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
