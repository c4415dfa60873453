"""A crowd of requests, or of streams, leaves the event loop to a stop that comes behind it."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from support import run_async

from calrig.api.streams import FairScheduler, FairStartMiddleware

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
