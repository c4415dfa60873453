"""What a monitoring system reads of a centre: what waits, since when, and which bench is silent."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import httpx
import pytest
from many_benches import ManyBenches, centre_with_benches
from prometheus_client.parser import text_string_to_metric_families as prometheus_text
from support import serving, wait_for
from table_bench import Measured, TableBench

from calrig.centre.service import CentreService

Values = dict[tuple[str, ...], float]
Hall = tuple[httpx.Client, ManyBenches]


def values(client: httpx.Client) -> Values:
    """Every sample, by its name and the values of its labels."""
    families = prometheus_text(client.get("/api/metrics").raise_for_status().text)
    return {(s.name, *s.labels.values()): s.value for family in families for s in family.samples}


@pytest.fixture
def halls(url: str) -> Iterator[Hall]:
    with centre_with_benches(url) as (service, benches), serving(service) as client:
        yield client, benches


def test_queues_are_counted_by_rig_until_a_bench_takes_the_order(halls: Hall) -> None:
    client, benches = halls
    runs = [benches.order("rig-03", f"AS-{k}") for k in range(3)]
    before = values(client)
    assert before["calrig_orders_waiting", "bench-1", "rig-03"] == 3
    assert before["calrig_orders_age_seconds", "bench-1", "rig-03"] > 0
    assert before["calrig_orders_waiting", "bench-8", "rig-40"] == 0
    benches.begin(runs[0])
    client.post(f"/api/runs/{runs[1].id}/abort").raise_for_status()
    assert values(client)["calrig_orders_waiting", "bench-1", "rig-03"] == 1


def test_each_bench_says_how_it_stands_and_since_when_it_is_silent(halls: Hall) -> None:
    client, benches = halls
    oldest_at = (datetime.now(UTC) - timedelta(hours=2)).isoformat()
    outbox = {"parcels": 18, "oldest_at": oldest_at}
    benches.beat("bench-7", ago_s=9000, outbox=outbox, lease_losses=4)
    found = values(client)
    assert 9000 <= found["calrig_bench_silence_seconds", "bench-7"] < 9600
    assert found["calrig_bench_silence_seconds", "bench-1"] == 0
    assert found["calrig_bench_outbox_parcels", "bench-7"] == 18
    assert 7200 <= found["calrig_bench_outbox_age_seconds", "bench-7"] < 7800
    assert found["calrig_bench_outbox_age_seconds", "bench-1"] == 0
    assert found["calrig_bench_lease_losses_total", "bench-7"] == 4


def test_commands_that_found_nobody_are_counted_for_an_hour(halls: Hall) -> None:
    client, benches = halls
    for age_s in (-600.0, 40.0, 2000.0, 4000.0):
        benches.unanswered("stop", "rig-31", age_s)
    found = values(client)
    assert found["calrig_commands_unanswered", "bench-7"] == 2
    assert found["calrig_commands_unanswered", "bench-1"] == 0


def test_no_label_grows_with_runs_or_units(halls: Hall) -> None:
    client, benches = halls
    benches.busy("rig-01", "AS-1")
    families = prometheus_text(client.get("/api/metrics").text)
    labels = {name for family in families for sample in family.samples for name in sample.labels}
    assert labels == {"bench", "rig", "state", "status", "version"}


def test_deliveries_that_are_not_unpacked_are_counted(
    centre: CentreService, bench: TableBench, measured: Measured
) -> None:
    with serving(centre) as client:
        first, *others = measured.parcels
        bench.deliver(measured.run.id, others)  # the first one is still on its way
        # Events are unpacked in their order, so theirs wait for it; samples need not.
        early = [document for document, _ in others if document["events"]]
        waiting = ("calrig_parcels_waiting", "hall-2")
        wait_for(lambda: values(client)[waiting] == len(early), "parcels that wait for the first")
        assert values(client)["calrig_parcels_age_seconds", "hall-2"] > 0
        assert values(client)["calrig_runs_stuck",] == 0
        bench.spoil(measured.run.id)
        bench.deliver(measured.run.id, [first])
        wait_for(lambda: values(client)["calrig_runs_stuck",] == 1, "a delivery that cannot be unpacked")
