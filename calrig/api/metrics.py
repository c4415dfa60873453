"""What a monitoring system reads: counts and states, by rig and kind, never by run or unit."""

from collections import Counter
from collections.abc import Iterator
from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.responses import Response
from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

import calrig
from calrig.api.context import ApiContext, Context
from calrig.runs.service import RunService
from calrig.store import Store, StoreError

RIG_STATES = ("idle", "busy", "unreachable")

router = APIRouter(tags=["service"])


@router.get(
    "/api/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
    summary="Prometheus text",
)
def metrics(context: Context, accept: Annotated[str, Header()] = "") -> Response:
    """Counts since the service began, and how things stand; OpenMetrics where `Accept` asks for it."""
    registry = CollectorRegistry(auto_describe=False)  # of this answer: what is counted is kept elsewhere
    registry.register(_Metrics(context))
    write, media_type = choose_encoder(accept)
    return Response(write(registry), media_type=media_type)


class _Metrics(Collector):
    def __init__(self, context: ApiContext) -> None:
        self._context = context

    def collect(self) -> Iterator[Metric]:
        """Every family, in the order shown."""
        service = self._context.service
        yield InfoMetricFamily("calrig_build", "The program that serves.", {"version": calrig.__version__})
        yield GaugeMetricFamily(
            "calrig_uptime_seconds", "Time since the service began.", service.meter.uptime_s
        )
        yield from _counted(service)
        yield _rig_states(service)
        yield GaugeMetricFamily(
            "calrig_event_clients", "Event streams that are open.", len(self._context.streams)
        )
        yield from _stored(self._context.store)


def _counted(service: RunService) -> Iterator[Metric]:
    counts = service.meter.counts()
    names = [rig.name for rig in service.rigs()]
    yield _counter("calrig_samples", "Valid samples taken from boards.", names, counts.samples)
    yield _counter("calrig_poses", "Poses measured and stored.", names, counts.poses)
    faults = CounterMetricFamily(
        "calrig_faults", "Faults seen on the wires and in samples.", labels=["rig", "kind"]
    )
    for (rig, kind), number in sorted(counts.faults.items()):
        faults.add_metric([rig, kind], number)
    yield faults
    ended = CounterMetricFamily("calrig_runs_ended", "Runs that ended.", labels=["rig", "status"])
    for (rig, status), number in sorted(counts.ended.items()):
        ended.add_metric([rig, status], number)
    yield ended


def _counter(name: str, words: str, rigs: list[str], numbers: Counter[str]) -> Metric:
    """A counter by rig, those that have counted nothing with 0: a rate needs a beginning."""
    family = CounterMetricFamily(name, words, labels=["rig"])
    for rig in rigs:
        family.add_metric([rig], numbers[rig])
    return family


def _rig_states(service: RunService) -> Metric:
    family = GaugeMetricFamily("calrig_rig_state", "1 for the state a rig is in.", labels=["rig", "state"])
    for rig in service.rigs():
        for state in RIG_STATES:
            family.add_metric([rig.name, state], float(rig.state == state))
    return family


def _stored(store: Store) -> Iterator[Metric]:
    """The store, as far as it can be read: that it cannot is what a watcher wants to know."""
    runs = GaugeMetricFamily("calrig_runs", "Runs in the store.", labels=["status"])
    try:
        for status, number in store.count_runs().items():
            runs.add_metric([status], number)
        up = 1.0
    except StoreError:
        up = 0.0
    yield GaugeMetricFamily("calrig_store_up", "1 where the store can be read.", up)
    yield runs
    size = store.size()
    yield GaugeMetricFamily(
        "calrig_store_size_bytes", "The store's file and its write-ahead log.", size.used_bytes
    )
    yield GaugeMetricFamily("calrig_store_free_bytes", "Room left on the store's disk.", size.free_bytes)
