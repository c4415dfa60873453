"""What a monitoring system reads of a centre's dealings with its benches: what waits, and who is silent."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from calrig.centre.bench_rigs import BenchRigs
from calrig.centre.said import said_lease_losses, said_outbox
from calrig.store import Store, StoreError
from calrig.store.bench_backlog import Backlog, Waiting
from calrig.store.benches import Bench

NOTHING = Waiting(0, 0.0)


class BenchCounts(Collector):
    """Looked up as it is asked for; of a store that cannot be read, nothing.

    Args:
        store: of the centre.
        stuck: the runs of which this process cannot unpack a delivery.
    """

    def __init__(self, store: Store, stuck: Callable[[], Mapping[str, str]]) -> None:
        self._store, self._rigs, self._stuck = store, BenchRigs(store), stuck

    def collect(self) -> Iterator[Metric]:
        """Every family."""
        try:
            benches, rigs, backlog = self._store.benches(), self._rigs.all(), self._store.backlog()
        except StoreError:
            return
        yield from _orders([(rig.bench.name, rig.settings.name) for rig in rigs], backlog)
        yield from _deliveries([bench.name for bench in benches], backlog)
        yield GaugeMetricFamily(
            "calrig_runs_stuck", "Runs with a delivery that cannot be unpacked.", len(self._stuck())
        )
        yield from _as_benches_say(benches)


def _orders(rigs: list[tuple[str, str]], backlog: Backlog) -> Iterator[Metric]:
    """By rig, those without any as well: a rate or an alarm needs the zero."""
    by = ["bench", "rig"]
    number = GaugeMetricFamily("calrig_orders_waiting", "Runs that no bench has taken yet.", labels=by)
    age = GaugeMetricFamily("calrig_orders_age_seconds", "Age of the oldest of them.", labels=by)
    for bench, rig in dict.fromkeys([*rigs, *backlog.orders]):
        waiting = backlog.orders.get((bench, rig), NOTHING)
        number.add_metric([bench, rig], waiting.number)
        age.add_metric([bench, rig], waiting.age_s)
    yield number
    yield age


def _deliveries(benches: list[str], backlog: Backlog) -> Iterator[Metric]:
    by = ["bench"]
    number = GaugeMetricFamily("calrig_parcels_waiting", "Parcels delivered and not unpacked.", labels=by)
    age = GaugeMetricFamily("calrig_parcels_age_seconds", "Age of the oldest of them.", labels=by)
    commands = GaugeMetricFamily(
        "calrig_commands_unanswered",
        "Commands of the last hour that a bench did not answer in time.",
        labels=by,
    )
    for bench in dict.fromkeys([*benches, *backlog.parcels, *backlog.unanswered]):
        waiting = backlog.parcels.get(bench, NOTHING)
        number.add_metric([bench], waiting.number)
        age.add_metric([bench], waiting.age_s)
        commands.add_metric([bench], backlog.unanswered.get(bench, 0))
    yield number
    yield age
    yield commands


def _as_benches_say(benches: list[Bench]) -> Iterator[Metric]:
    """What each last said of itself; of a bench that never spoke there is nothing to tell."""
    by, now = ["bench"], datetime.now(UTC)
    silence = GaugeMetricFamily("calrig_bench_silence_seconds", "Age of a bench's last word.", labels=by)
    parcels = GaugeMetricFamily(
        "calrig_bench_outbox_parcels", "Pieces of runs a bench had yet to deliver.", labels=by
    )
    age = GaugeMetricFamily("calrig_bench_outbox_age_seconds", "Age of the oldest event of these.", labels=by)
    losses = CounterMetricFamily(
        "calrig_bench_lease_losses", "How often a bench lost its lease since its agent began.", labels=by
    )
    for bench in benches:
        if bench.seen_ago_s is not None:
            silence.add_metric([bench.name], max(0.0, bench.seen_ago_s))
        outbox, lost = said_outbox(bench), said_lease_losses(bench)
        if outbox is not None:
            since = outbox.oldest_at or now
            parcels.add_metric([bench.name], outbox.parcels)
            age.add_metric([bench.name], max(0.0, (now - since).total_seconds()))
        if lost is not None:
            losses.add_metric([bench.name], lost)
    yield silence
    yield parcels
    yield age
    yield losses
