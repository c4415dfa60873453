"""Delivers what the spool keeps to the centre, in order, and goes on after days where it was.

A parcel that was delivered and could not be noted as such is delivered once more: the centre knows events by
run and number, poses by run and index, samples by run and block.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Sequence

from calrig.agent.link import NOW, Link, LinkDown, json_of
from calrig.store import Store, StoreError
from calrig.store.errors import StoreDamagedError
from calrig.store.parcels import Parcel

log = logging.getLogger(__name__)

LOOK_S = 1.0
"""How often the spool is looked into though nobody says that it has grown, or though the centre is away."""
PACE_S = 0.4
"""Between two deliveries: what a run tells meanwhile goes together, which costs the centre a third."""
FEW = 20
TOGETHER_BYTES = 1_000_000
_NEWEST = "SELECT coalesce(max(seq), 0) FROM parcel WHERE bench = %s"
_INSERT = f"""
INSERT INTO parcel (bench, seq, run_uid, document, data, delivered_at) VALUES (%s, %s, %s, %s, %s, {NOW})
"""  # noqa: S608 (no text of anybody's)


class Outbox:
    """In a thread of its own, until `closing` is set, and once more after that.

    Args:
        link: to the centre, which nobody else waits for.
        store: the spool.
        closing: ends it.
    """

    def __init__(self, link: Link, store: Store, closing: threading.Event) -> None:
        self._link, self._store, self._closing = link, store, closing
        self._grown = threading.Event()
        self._unreadable: set[str] = set()

    def wake(self) -> None:
        """The spool has grown, or nobody is to wait any more."""
        self._grown.set()

    def run(self) -> None:
        """Delivers until the agent is closed, then what was said last."""
        is_last = False
        while not is_last:
            self._grown.wait(LOOK_S)
            self._grown.clear()
            is_last = self._closing.is_set()
            try:
                while (n := self.deliver_some()) and not is_last:
                    if n < FEW:  # what waited for days goes out without waiting any more
                        self._closing.wait(PACE_S)
            except LinkDown:
                self._closing.wait(LOOK_S)  # the heartbeat tells of it
            except StoreError as error:
                log.error("the spool cannot be delivered from: %s", error)
                self._closing.wait(LOOK_S)

    def deliver_some(self) -> int:
        """Delivers the next pieces of every run that has any; returns how many there were.

        A run of today goes on being told while days of others are delivered beside it.

        Raises:
            LinkDown: the centre is away, or may not have got them.
        """
        n = 0
        for parcels in self._loads():
            with self._link.centre() as centre, centre.connection.transaction():
                (newest,) = centre.connection.execute(_NEWEST, (centre.bench,)).fetchone() or (0,)
                rows = [
                    (centre.bench, seq, one.run_id, json_of(one.document), one.data)
                    for seq, one in enumerate(parcels, start=newest + 1)
                ]
                centre.connection.cursor().executemany(_INSERT, rows)
            self._store.spool.mark_delivered(parcels)
            n += len(parcels)
        return n

    def _loads(self) -> Iterator[Sequence[Parcel]]:
        """The next pieces of all runs, as many together as are sent in one transaction."""
        load: list[Parcel] = []
        n_bytes = 0
        for run_id in self._store.spool.undelivered():
            parcels = self._next_of(run_id)
            load += parcels
            n_bytes += sum(len(one.data or b"") for one in parcels)
            if n_bytes >= TOGETHER_BYTES:
                yield load
                load, n_bytes = [], 0
        if load:
            yield load

    def _next_of(self, run_id: str) -> Sequence[Parcel]:
        """A run that cannot be read any more keeps no other one from being delivered."""
        try:
            return self._store.spool.next_parcels(run_id)
        except StoreDamagedError as error:
            if run_id not in self._unreadable:
                log.error("run %s cannot be delivered: %s", run_id, error)
            self._unreadable.add(run_id)
            return ()
