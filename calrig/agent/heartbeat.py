"""Tells the centre every other second that the bench is there and how its rigs stand; renews the lease.

What is seen of a unit that somebody mounts is told as it changes.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import calrig
from calrig.agent.lease import Lease
from calrig.agent.link import NOW, Link, LinkDown, json_of
from calrig.runs.look import Look
from calrig.runs.said_rigs import said_of
from calrig.runs.service import RunService
from calrig.store import StoreError
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
        service, outbox = self._service, self._service.store.outbox()
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

    def _rest(self, told: Mapping[str, Look]) -> None:
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
