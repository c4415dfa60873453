"""What a bench does for its centre, beside the run service that the person at the bench works with.

Each link has threads of its own, which wait for the network and hold nothing that a run could need meanwhile.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from calrig.agent.commands import Commands
from calrig.agent.heartbeat import Heartbeat
from calrig.agent.lease import Lease
from calrig.agent.link import Link
from calrig.agent.link_counts import LinkCounts
from calrig.agent.orders import RigOrders
from calrig.agent.outbox import Outbox
from calrig.agent.queue_worker import QueueWorker
from calrig.runs.service import RunService

log = logging.getLogger(__name__)

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
