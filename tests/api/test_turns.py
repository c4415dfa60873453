"""Crowds of requests and streams: they share looks into the store, and leave the event loop to a stop."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest
from support import run_async

from calrig.api.streams import FairScheduler, FairStartMiddleware, ReadCache, ReadCoalescer
from calrig.store import StoreError

CROWD = 50


def begun_before(path: str) -> int:
    """How many of a crowd of requests have begun when one that has come behind them all begins."""
    begun: list[str] = []

    async def app(scope: Any, _receive: object, _send: object) -> None:
        begun.append(scope["path"])

    async def ask() -> None:
        requests = FairStartMiddleware(app)
        paths = [*(f"/api/runs/{k}" for k in range(CROWD)), path]
        scopes = [{"type": "http", "path": one} for one in paths]
        await asyncio.gather(*(requests(scope, None, None) for scope in scopes))  # type: ignore[arg-type]

    run_async(ask())
    assert len(begun) == CROWD + 1
    return begun.index(path)


@pytest.mark.parametrize("path", ["/api/rigs/bench-1/stop", "/api/runs/17/abort", "/api/health"])
def test_a_stop_begins_before_all_that_wait(path):
    assert begun_before(path) == 0


@pytest.mark.parametrize("path", ["/api/rigs", "/api/runs/17/aborted", "/api/rigs/a/b/stop"])
def test_any_other_request_begins_in_its_turn(path):
    assert begun_before(path) == CROWD


@pytest.mark.parametrize("in_a_round", [1, 4])
def test_the_event_loop_comes_round_between_turns(in_a_round):
    """What comes meanwhile waits for one round's, however many wait, and who left is not waited for."""
    went, went_when_it_came = 0, []

    async def crowd() -> None:
        turns, loop = FairScheduler(in_a_round), asyncio.get_running_loop()

        async def one() -> None:
            nonlocal went
            await turns.wait()
            went += 1
            if went % in_a_round == 0:
                loop.call_soon(lambda: went_when_it_came.append(went))

        tasks = [asyncio.create_task(one()) for _ in range(CROWD)]
        left = asyncio.create_task(turns.wait())
        await asyncio.sleep(0)
        left.cancel()
        await asyncio.gather(*tasks)

    run_async(crowd())
    assert went == CROWD
    dues = range(in_a_round, CROWD + 1, in_a_round)
    waited_for = [came - due for came, due in zip(went_when_it_came, dues, strict=True)]
    assert max(waited_for) <= in_a_round


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
