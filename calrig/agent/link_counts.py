"""What a monitoring system reads of a bench's dealings with its centre."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from calrig.agent.lease import Lease
from calrig.store import Store, StoreError


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
            outbox = self._store.outbox()
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
