"""What a monitoring system reads: counts and states, by rig and kind, never by run or unit."""

from collections.abc import Iterator
from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.responses import Response
from prometheus_client import CollectorRegistry
from prometheus_client.core import GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector
from starlette.concurrency import run_in_threadpool

import calrig
from calrig.api.context import ApiContext, Context
from calrig.api.overview import overdue_units
from calrig.api.routes import TEXT, answers
from calrig.store import StoreError

RIG_STATES = ("idle", "busy", "unreachable", "offline")

router = APIRouter(tags=["service"])


@router.get("/api/metrics", **answers(None, "Prometheus text", sends={"text/plain": TEXT}))
async def metrics(context: Context, accept: Annotated[str, Header()] = "") -> Response:
    """Counts since the service began, and how things stand; OpenMetrics where `Accept` asks for it."""
    try:
        overdue = len(await overdue_units(context))
    except StoreError:
        overdue = None  # as `calrig_store_up` tells
    answered = CollectorRegistry(auto_describe=False)
    answered.register(context.service.meter.registry)
    answered.register(_Standing(context, overdue))
    write, media_type = choose_encoder(accept)
    return Response(await run_in_threadpool(write, answered), media_type=media_type)


class _Standing(Collector):
    """How things stand, looked up as it is asked for: nobody could keep gauges of the store up to date."""

    def __init__(self, context: ApiContext, overdue: int | None) -> None:
        self._service, self._store, self._streams = context.service, context.store, context.streams
        self._overdue = overdue

    def collect(self) -> Iterator[Metric]:
        yield InfoMetricFamily("calrig_build", "The program that serves.", {"version": calrig.__version__})
        rigs = GaugeMetricFamily("calrig_rig_state", "1 for the state a rig is in.", labels=["rig", "state"])
        for rig in self._service.rigs():
            for state in RIG_STATES:
                rigs.add_metric([rig.name, state], float(rig.state == state))
        yield rigs
        yield GaugeMetricFamily("calrig_event_clients", "Event streams that are open.", len(self._streams))
        yield from self._stored()

    def _stored(self) -> Iterator[Metric]:
        """The store, as far as it can be read: that it cannot is what a watcher wants to know."""
        runs = GaugeMetricFamily("calrig_runs", "Runs in the store.", labels=["status"])
        overdue = GaugeMetricFamily("calrig_units_overdue", "Units that are due to be calibrated.", labels=[])
        try:
            for status, number in self._store.runs.count_by_status().items():
                runs.add_metric([status], number)
            up = 1.0
        except StoreError:
            up = 0.0
        if self._overdue is not None:
            overdue.add_metric([], self._overdue)
        yield overdue
        yield GaugeMetricFamily("calrig_store_up", "1 where the store can be read.", up)
        yield runs
        size = self._store.size()
        yield GaugeMetricFamily(
            "calrig_store_size_bytes", "The store's file and its write-ahead log.", size.used_bytes
        )
        if size.free_bytes is not None:
            yield GaugeMetricFamily(
                "calrig_store_free_bytes", "Room left on the store's disk.", size.free_bytes
            )
