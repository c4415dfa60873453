"""Procrastinate's queues of the runs that benches are to carry out, one a rig, in the centre's database.

A job is a wake-up and nothing more: it says that a run has an order of some epoch. What is to be done stands
in `run_order`; a job that comes twice, late or not at all changes nothing of it. The engine retries none.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Coroutine
from typing import Any

import psycopg
from procrastinate import App, SyncPsycopgConnector
from procrastinate.connector import BaseConnector

CARRY_OUT = "carry_out"
"""The only task: `carry_out(run_uid, epoch)`."""
LONGEST_QUEUE = 40
"""Bytes. Its channel, `procrastinate_queue_v1#` and the name, has to fit PostgreSQL's 63."""
LONGEST_BENCH = 24
"""Bytes of a bench's name: what leaves room for a rig in the name of a queue."""
OF_A_BENCH = "rig:{bench}/"
"""What the names of all queues of a bench begin with, and of no other's: `/` is in no bench's name."""

HandOver = Callable[[str, int], Coroutine[Any, Any, None]]
"""Takes a run's id and an epoch."""


def queue_of(bench: str, rig: str) -> str:
    """The queue of a bench's rig, and the lock of its jobs: `rig:hall-2/bench-1`, a long one with a hash.

    Raises:
        ValueError: the bench's name is longer than `LONGEST_BENCH`.
    """
    if len(bench.encode()) > LONGEST_BENCH:
        raise ValueError(f"the name of bench {bench!r} is longer than {LONGEST_BENCH} bytes")
    prefix = OF_A_BENCH.format(bench=bench)
    if len((prefix + rig).encode()) <= LONGEST_QUEUE:
        return prefix + rig
    return prefix + hashlib.sha256(rig.encode()).hexdigest()[: LONGEST_QUEUE - len(prefix.encode())]


def defer(connection: psycopg.Connection[Any], bench: str, rig: str, run_uid: str, epoch: int) -> None:
    """Puts the job of an order into its rig's queue, in the transaction that the order is written in."""
    queue = queue_of(bench, rig)
    job = _DEFERRING.configure_task(CARRY_OUT, queue=queue, lock=queue, connection=connection)
    job.defer(run_uid=run_uid, epoch=epoch)


def app_of(connector: BaseConnector, hand_over: HandOver) -> App:
    """The application of a bench's worker: each job hands its epoch over and has then succeeded."""
    app = App(connector=connector)
    app.task(name=CARRY_OUT, retry=False)(hand_over)
    return app


_DEFERRING = App(connector=SyncPsycopgConnector())
"""Never opened: each job goes by the connection of its order."""
