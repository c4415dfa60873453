"""Procrastinate worker: takes the jobs that announce orders for the rigs of this bench.

It has its own thread and event loop, touches neither rigs nor spool, and restarts after each connection loss.
Half-done jobs of an earlier worker would block their queue. It removes them first: no other worker takes
from these queues.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress

import psycopg
import psycopg_pool
from procrastinate import App, PsycopgConnector
from procrastinate.exceptions import ProcrastinateException
from procrastinate.jobs import Status

from calrig.agent.link import Link, LinkDown
from calrig.store.bench_tables import queue_of
from calrig.store.postgresql.database import ALIVE
from calrig.store.postgresql.queue import app_of

log = logging.getLogger(__name__)

AGAIN_S = 2.0
LOOK_S = 5.0
"""How often the queues are looked into though no notification came."""


class QueueWorker:
    """In a thread of its own, until it is closed.

    Args:
        url: of the centre's database, as libpq takes it.
        link: tells whether the centre can be reached, and this bench's name.
        rigs: names of the bench's rigs.
        look: is called where a job has said that there is an order.
    """

    def __init__(self, url: str, link: Link, rigs: Sequence[str], look: Callable[[], None]) -> None:
        self._url, self._link, self._rigs, self._look = url, link, rigs, look
        self._closing = threading.Event()
        self._ending: Callable[[], object] = lambda: None

    def run(self) -> None:
        """Works until it is closed."""
        for noisy in ("psycopg.pool", "procrastinate"):  # a traceback for whatever a lost connection ends
            logging.getLogger(noisy).setLevel(logging.CRITICAL)
        said = ""
        while not self._closing.is_set():
            try:
                with self._link.centre() as centre:
                    bench = centre.bench
                asyncio.run(self._work([queue_of(bench, rig) for rig in self._rigs]))
                said = ""
            except LinkDown:
                pass  # the heartbeat tells of it
            except (ProcrastinateException, psycopg.Error, psycopg_pool.PoolTimeout, ValueError) as error:
                if said != (why := " ".join(str(error.__cause__ or error).split())):
                    log.warning("jobs are not taken, orders are looked for all the same: %s", why)
                said = why
            self._closing.wait(AGAIN_S)

    def close(self) -> None:
        """Ends it; may be called from any thread."""
        self._closing.set()
        with suppress(RuntimeError):  # its loop has just ended by itself
            self._ending()

    async def _hand_over(self, run_uid: str, epoch: int) -> None:
        log.info("a job says that run %s has an order of epoch %d", run_uid, epoch)
        self._look()

    async def _work(self, queues: list[str]) -> None:
        connector = PsycopgConnector(
            conninfo=self._url, kwargs=ALIVE, min_size=1, max_size=2, timeout=5.0, reconnect_timeout=10.0
        )
        app = app_of(connector, self._hand_over)
        loop, me = asyncio.get_running_loop(), asyncio.current_task()
        assert me is not None  # noqa: S101 (a coroutine that runs is a task's)
        self._ending = lambda: loop.call_soon_threadsafe(me.cancel)
        if self._closing.is_set():
            return
        try:
            async with app.open_async():
                await _put_away(app, queues)
                await app.run_worker_async(
                    queues=queues, install_signal_handlers=False, fetch_job_polling_interval=LOOK_S
                )
        except asyncio.CancelledError:
            if not self._closing.is_set():
                raise
        finally:
            self._ending = lambda: None


async def _put_away(app: App, queues: Sequence[str]) -> None:
    """Jobs that somebody took and never ended: what they had to say is in the table of orders."""
    for queue in queues:
        for job in await app.job_manager.list_jobs_async(queue=queue, status=Status.DOING.value):
            await app.job_manager.finish_job(job, status=Status.FAILED, delete_job=False)
