"""Tells the centre every other second that the bench is there and how its rigs stand; renews the lease.

What is seen of a unit that somebody mounts is told as it changes.

What a monitoring system reads of a bench's dealings with its centre.

What a bench does for its centre, beside the run service that the person at the bench works with.

Each link has threads of its own, which wait for the network and hold nothing that a run could need meanwhile.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

import calrig
from calrig.agent.commands import Commands
from calrig.agent.link import NOW, Lease, Link, LinkDown, json_of
from calrig.agent.orders import RigOrders
from calrig.agent.outbox import Outbox
from calrig.agent.queue_worker import QueueWorker
from calrig.runs.presence import BoardCheck
from calrig.runs.rig_status import said_of
from calrig.runs.service import RunService
from calrig.store import Store, StoreError
from calrig.store.convert import iso_utc

log = logging.getLogger(__name__)

BEAT_S = 2.0
SEES_S = 0.2
"""How soon what is seen of a unit is told."""
_BEAT = f"UPDATE bench SET last_seen_at = {NOW}, said = %s WHERE name = %s"  # noqa: S608 (no text of anybody's)


class Heartbeat:
    """In a thread of its own, until `closing` is set.

    Args:
        link: to the centre.
        lease: is renewed by each beat that was answered.
        service: carries out the runs of the bench.
        closing: ends it.
        renewed: is called once a lost lease is held again.
    """

    def __init__(
        self,
        link: Link,
        lease: Lease,
        service: RunService,
        closing: threading.Event,
        renewed: Callable[[], None],
    ) -> None:
        self._link, self._lease, self._service = link, lease, service
        self._closing, self._renewed = closing, renewed
        self._is_up: bool | None = None

    def run(self) -> None:
        """Beats until the agent is closed."""
        while not self._closing.is_set():
            told = self._service.looks()
            try:
                self.beat()
            except (LinkDown, StoreError) as error:
                self._tell(is_up=False, said=f"the centre cannot be reached: {error}")
            self._lease.is_held()  # a loss is counted when it happens, and not when somebody asks
            self._rest(told)

    def beat(self) -> None:
        """Says how the bench stands.

        Raises:
            LinkDown: nobody answered.
        """
        said = self.said()
        asked_at_s = self._lease.asked_at_s()
        with self._link.centre() as centre:
            centre.connection.execute(_BEAT, (json_of(said), centre.bench))
        self._tell(is_up=True, said=f"bench {centre.bench} is in touch with its centre")
        if self._lease.renew(asked_at_s):
            self._renewed()

    def said(self) -> dict[str, Any]:
        """What the bench says of itself."""
        service, outbox = self._service, self._service.store.spool.outbox()
        looks = service.looks()
        return {
            "rigs": [
                said_of(state, service.known_rig(state.name), looks.get(state.name))
                for state in service.rigs()
            ],
            "outbox": {
                "parcels": outbox.n_parcels,
                "oldest_at": None if outbox.oldest_at is None else iso_utc(outbox.oldest_at),
            },
            "lease_losses": self._lease.losses,
            "version": calrig.__version__,
        }

    def _rest(self, told: Mapping[str, BoardCheck]) -> None:
        """Until the next beat is due: sooner where something else is seen, for somebody stands there."""
        due_s = time.monotonic() + BEAT_S
        while time.monotonic() < due_s and self._service.looks() == told:
            if self._closing.wait(SEES_S):
                return

    def _tell(self, *, is_up: bool, said: str) -> None:
        """Logs what has changed, and not what stays as it is."""
        if is_up is not self._is_up:
            log.log(logging.INFO if is_up else logging.WARNING, "%s", said)
        self._is_up = is_up


class LinkCounts(Collector):
    """Looked up as it is asked for; of a spool that cannot be read, nothing."""

    def __init__(self, lease: Lease, store: Store) -> None:
        self._lease, self._store = lease, store

    def collect(self) -> Iterator[Metric]:
        """Every family."""
        held = float(self._lease.is_held())
        yield GaugeMetricFamily("calrig_lease_held", "1 while orders of the centre are acted on.", held)
        yield CounterMetricFamily(
            "calrig_lease_losses", "How often the centre did not answer in time.", self._lease.losses
        )
        try:
            outbox = self._store.spool.outbox()
        except StoreError:
            return
        oldest_at = outbox.oldest_at
        age_s = 0.0 if oldest_at is None else (datetime.now(UTC) - oldest_at).total_seconds()
        yield GaugeMetricFamily(
            "calrig_outbox_parcels", "Pieces of runs not delivered yet.", outbox.n_parcels
        )
        yield GaugeMetricFamily(
            "calrig_outbox_age_seconds", "Age of the oldest event not delivered yet.", max(0.0, age_s)
        )


AFTER_A_DEFECT_S = 5.0
GOODBYE_S = 2.0
"""How long what a bench has to say last may take, and the ends of its threads."""


class Agent:
    """The threads between a bench and its centre.

    Args:
        service: carries runs out, over the bench's spool, and drafts nothing.
        url: of the centre's database, as libpq takes it.
        now_s: seconds that never go back, by which the lease is counted.
    """

    def __init__(self, service: RunService, url: str, now_s: Callable[[], float] = time.monotonic) -> None:
        self.service = service
        self.lease = Lease(now_s)
        self._closing, self._all_is_said = threading.Event(), threading.Event()
        short, heard, parcels = (Link(url) for _ in range(3))
        self._links = short, heard, parcels
        rigs = [service.known_rig(state.name) for state in service.rigs()]
        self._orders = [RigOrders(rig, short, self.lease, service, self._closing) for rig in rigs]
        self._heartbeat = Heartbeat(short, self.lease, service, self._closing, self.look)
        self._outbox = Outbox(parcels, service.store, self._all_is_said)
        self._worker = QueueWorker(url, short, [rig.name for rig in rigs], self.look)
        commands = Commands(heard, short, service, self._closing)
        work = {
            "heartbeat": self._heartbeat.run,
            "outbox": self._outbox.run,
            "commands": commands.run,
            "jobs": self._worker.run,
            **{one.name: one.run for one in self._orders},
        }
        self._threads = [
            threading.Thread(target=self._keep_going, args=(name, run), name=name, daemon=True)
            for name, run in work.items()
        ]
        service.bus.subscribe_to_all(self._outbox.wake)
        service.meter.registry.register(LinkCounts(self.lease, service.store))

    def start(self) -> None:
        """Begins all of it."""
        for thread in self._threads:
            thread.start()

    def look(self) -> None:
        """There may be orders."""
        for orders in self._orders:
            orders.wake()

    def close(self) -> None:
        """Ends runs and threads; what is left to be said is said where the centre is there to hear it."""
        self._closing.set()
        self._worker.close()
        self.service.close()
        self._all_is_said.set()
        self._outbox.wake()
        for thread in self._threads:
            thread.join(GOODBYE_S)
        for link in self._links:
            link.close()

    def _keep_going(self, name: str, run: Callable[[], None]) -> None:
        """A defect in one thread is told, and ends no other one; nor that one for good."""
        while True:
            try:
                run()
                return
            except Exception:
                log.exception("%s failed inside calrig, and begins anew", name)
                if self._closing.wait(AFTER_A_DEFECT_S):
                    return
