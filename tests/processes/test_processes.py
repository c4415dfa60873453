"""Heavy work in another process: what it may take, how it ends, and that the next piece finds a process."""

from __future__ import annotations

import asyncio
import operator
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from functools import partial

import psutil
import pytest
from pieces import in_steps
from support import program, wait_for

from calrig.processes import child, pool
from calrig.processes.pool import (
    MOST_WAITING,
    Processes,
    WorkLost,
    WorkRefused,
    WorkTooLarge,
    run_in_subprocess,
)

FOR_EVER = partial(time.sleep, 3600.0)
OTHERS: set[int] = set()
"""Processes that were there before the test: services of other tests share some."""


@pytest.fixture(autouse=True)
def _others() -> None:
    OTHERS.clear()
    OTHERS.update(one.pid for one in psutil.Process().children())


def children() -> list[psutil.Process]:
    """Those of the pool: Python's own tracker of resources, which another test may have begun, stays."""
    known = []
    for one in psutil.Process().children():
        if one.pid in OTHERS:
            continue
        with suppress(psutil.NoSuchProcess):
            # one that has died is counted until the loop has seen it off
            if one.status() == psutil.STATUS_ZOMBIE or child.__name__ in " ".join(one.cmdline()):
                known.append(one)
    return known


@asynccontextmanager
async def processes(**bounds: float) -> AsyncIterator[Processes]:
    one = Processes(1, **bounds)
    yield one
    await one.close()
    assert children() == []


def test_every_way_that_a_piece_can_end_leaves_a_process_for_the_next() -> None:
    async def pieces() -> None:
        async with processes(most_bytes=500_000_000) as pool:
            ours = await pool.run(os.getpid)
            assert ours != os.getpid()
            with pytest.raises(ValueError, match="invalid literal"):
                await pool.run(partial(int, "x"))
            with pytest.raises(WorkTooLarge, match=r"more than 500 MB of memory .* take fewer poses"):
                await pool.run(partial(bytearray, 10**9))
            assert await pool.run(os.getpid) == ours, "these end the piece, not the process"
            with pytest.raises(WorkLost, match="its process ended \\(status -9\\)"):
                await pool.run(partial(signal.raise_signal, signal.SIGKILL))
            assert await pool.run(os.getpid) not in {ours, os.getpid()}
            assert await pool.run(partial(os.getenv, "OPENBLAS_NUM_THREADS")) == "1"

    asyncio.run(pieces())


def test_a_process_that_died_while_it_waited_is_replaced() -> None:
    async def pieces() -> None:
        async with processes() as pool:
            idle = psutil.Process(await pool.run(os.getpid))
            idle.kill()
            while psutil.pid_exists(idle.pid):  # one that is ending has no command line any more
                await asyncio.sleep(0.01)
            for _ in range(3):
                await asyncio.sleep(0)  # the loop hears that the pipe was closed
            assert await pool.run(partial(operator.add, 1, 2)) == 3

    asyncio.run(pieces())


def test_a_piece_that_takes_too_long_is_ended() -> None:
    async def pieces() -> None:
        async with processes(longest_s=0.0) as pool:
            with pytest.raises(WorkTooLarge, match="longer than 0 s and was ended"):
                await pool.run(FOR_EVER)
            assert children() == []

    asyncio.run(pieces())


def test_a_piece_that_nobody_waits_for_any_more_stops_at_once_and_the_next_is_carried_out() -> None:
    async def pieces() -> None:
        async with processes() as pool:
            given_up = asyncio.create_task(pool.run(FOR_EVER))
            while not children():
                await asyncio.sleep(0.01)
            (works,) = children()
            next_one = asyncio.create_task(pool.run(partial(operator.add, 1, 2)))
            given_up.cancel()
            assert await next_one == 3
            assert given_up.cancelled()
            assert not works.is_running()

    asyncio.run(pieces())


def test_more_than_may_wait_are_refused_at_once() -> None:
    async def pieces() -> None:
        async with processes() as pool:
            in_hand = [asyncio.create_task(pool.run(FOR_EVER)) for _ in range(1 + MOST_WAITING)]
            await asyncio.sleep(0)
            with pytest.raises(WorkRefused, match=f"{1 + MOST_WAITING} diagnoses.*try again later"):
                await pool.run(os.getpid)
            for piece in in_hand:
                piece.cancel()
            await asyncio.wait(in_hand)

    asyncio.run(pieces())


def test_who_has_many_pieces_waiting_neither_refuses_nor_keeps_waiting_whom_has_one() -> None:
    async def pieces() -> None:
        order: list[str] = []
        async with processes() as pool:
            in_hand = asyncio.create_task(pool.run(FOR_EVER, user="ada"))
            await asyncio.sleep(0)
            of_ada = [
                asyncio.create_task(pool.run(os.getpid, user="ada", begun=lambda: order.append("ada")))
                for _ in range(MOST_WAITING)
            ]
            await asyncio.sleep(0)
            with pytest.raises(WorkRefused, match=f"{1 + MOST_WAITING} diagnoses.* of one user"):
                pool.require_room("ada")
            of_ben = asyncio.create_task(pool.run(os.getpid, user="ben", begun=lambda: order.append("ben")))
            await asyncio.sleep(0)
            of_ada[0].cancel()
            in_hand.cancel()
            await asyncio.wait([*of_ada, of_ben])
        assert order.index("ben") <= 1
        assert len(order) == MOST_WAITING

    asyncio.run(pieces())


def test_the_pieces_of_all_users_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "MOST_WAITING_ALL", 1)

    async def pieces() -> None:
        async with processes() as one:
            in_hand = [asyncio.create_task(one.run(FOR_EVER, user=user)) for user in ("ada", "ben")]
            await asyncio.sleep(0)
            with pytest.raises(WorkRefused, match=r"2 diagnoses.* of all users"):
                one.require_room("cleo")
            for piece in in_hand:
                piece.cancel()
            await asyncio.wait(in_hand)

    asyncio.run(pieces())


def test_a_thread_without_a_loop_has_a_process_for_one_piece() -> None:
    assert run_in_subprocess(os.getppid) == os.getpid()
    assert children() == []


PARENT = """
import asyncio, os, time
from functools import partial
from calrig.processes.pool import Processes

async def work():
    processes = Processes(1)
    print(await processes.run(os.getpid), flush=True)
    await processes.run(partial(time.sleep, 3600))

asyncio.run(work())
"""


def test_a_process_does_not_outlive_a_parent_that_was_killed() -> None:
    with program(sys.executable, "-c", PARENT) as parent:
        assert parent.stdout is not None
        worker = psutil.Process(int(parent.stdout.readline()))
        parent.kill()
    wait_for(lambda: not worker.is_running() or worker.status() == psutil.STATUS_ZOMBIE, "end of the orphan")


def test_a_piece_tells_when_it_begins_and_how_far_it_is() -> None:
    async def pieces() -> None:
        heard: list[object] = []
        async with processes() as pool:
            in_hand = asyncio.create_task(pool.run(FOR_EVER))
            await asyncio.sleep(0)
            later = asyncio.create_task(
                pool.run(in_steps, begun=lambda: heard.append("begun"), progress=heard.append)
            )
            await asyncio.sleep(0)
            assert heard == [], "another one has the process"
            in_hand.cancel()
            assert await later == "done"
            assert heard == ["begun", 0.25, 0.5]

    asyncio.run(pieces())


def test_what_is_carried_out_apart_loads_no_database() -> None:
    """Its libraries take longer to load than most pieces take."""
    pieces = "imports, noise_studies, solutions, stored_runs"
    look = "[name for name in ('sqlalchemy', 'fastapi') if name in sys.modules]"
    command = f"import sys; from calrig.analysis import {pieces}; print({look})"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
