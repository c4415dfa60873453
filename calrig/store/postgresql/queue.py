"""Procrastinate queues in the centre's database: one per rig, for the runs that its bench carries out.

A job is only a wake-up: a run has an order of some epoch. The row in `run_order` is authoritative, so a job
that arrives twice, late or never changes nothing. Jobs are not retried.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import psycopg
from procrastinate import App, SyncPsycopgConnector
from procrastinate.connector import BaseConnector

from calrig.store.bench_tables import queue_of

CARRY_OUT = "carry_out"
"""The only task: `carry_out(run_uid, epoch)`."""

HandOver = Callable[[str, int], Coroutine[Any, Any, None]]
"""Takes a run's id and an epoch: parameters `run_uid` and `epoch`."""


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
