"""Forty rigs at a glance, and what a monitoring system reads of a centre: what waits, and who is silent."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest
from dated_runs import FIRST_DAY, gave, lay
from many_benches import ManyBenches, a_day_in_the_halls, centre_with_benches
from prometheus_client.parser import text_string_to_metric_families as prometheus_text
from support import serving, wait_for
from table_bench import Measured, TableBench

from calrig.centre.service import CentreService

Hall = tuple[httpx.Client, ManyBenches]


@pytest.fixture
def halls(url: str) -> Iterator[Hall]:
    with centre_with_benches(url) as (service, benches), serving(service) as client:
        yield client, benches


def rigs_of(client: httpx.Client) -> dict[str, dict[str, Any]]:
    found = client.get("/api/benches/overview").raise_for_status().json()
    return {rig["name"]: rig for bench in found for rig in bench["rigs"]}


def test_each_rig_says_what_it_does_what_waits_what_failed_and_which_check_is_due(halls: Hall) -> None:
    client, benches = halls
    a_day_in_the_halls(benches)
    found = client.get("/api/benches/overview").raise_for_status().json()
    rigs = {rig["name"]: rig for bench in found for rig in bench["rigs"]}
    assert len(rigs) == 40
    assert [bench["name"] for bench in found] == benches.benches
    assert rigs["rig-03"]["state"] == "busy"
    assert rigs["rig-03"]["run"]["progress"] == {
        "poses_done": 9, "poses_total": 52, "fraction": 9 / 52, "remaining_s": 495.0,
        "waiting_for": None,
    }  # fmt: skip
    assert [run["unit"] for run in rigs["rig-03"]["queued"]] == ["AS-2001", "AS-2002", "AS-2003", "AS-2004"]
    assert rigs["rig-16"]["run"]["status"] == "paused"
    assert rigs["rig-16"]["run"]["waiting_for"] == {"mount_deg": 90.0, "mount_axis": "x"}
    failed = {name: rig["unresolved"]["status"] for name, rig in rigs.items() if rig["unresolved"]}
    assert failed == {"rig-18": "failed", "rig-22": "interrupted"}  # on rig-23 somebody began another run
    assert rigs["rig-24"]["state"] == "unreachable"
    assert {name: rig["check"]["overdue"] for name, rig in rigs.items() if rig["check"]} == {
        "rig-25": True,
        "rig-26": False,
    }
    (away,) = [bench for bench in found if bench["state"] == "silent"]
    assert (away["name"], away["hall"], away["undelivered"]["parcels"]) == ("bench-7", "hall 10", 18)
    assert away["silent_for_s"] == 7200
    assert {rig["state"] for rig in away["rigs"]} == {"offline"}
    assert rigs["rig-31"]["run"]["unit"] == "AS-1031"  # the last that is known of it


def test_a_failure_that_was_seen_to_is_told_no_more(halls: Hall) -> None:
    client, benches = halls
    voided = benches.ended("rig-01", "A", "failed", "slipped")
    interrupted = benches.ended("rig-02", "B", "interrupted", "the service ended")
    assert {name for name, rig in rigs_of(client).items() if rig["unresolved"]} == {"rig-01", "rig-02"}
    client.post(f"/api/runs/{voided.id}/void", json={"reason": "the wrong unit"}).raise_for_status()
    assert client.post(f"/api/runs/{interrupted.id}/resume").json()["status"] == "queued"
    benches.begin(interrupted, 13)
    wait_for(lambda: not [rig for rig in rigs_of(client).values() if rig["unresolved"]], "a fresh answer")
    assert rigs_of(client)["rig-02"]["run"]["id"] == interrupted.id


def test_an_answer_is_304_until_something_happens(halls: Hall) -> None:
    client, benches = halls
    path = "/api/benches/overview"
    first = client.get(path)
    for bench in benches.benches:
        benches.beat(bench)  # that they are still there is nothing new
    known = {"If-None-Match": first.headers["etag"]}
    again = client.get(path, headers=known)
    assert (again.status_code, again.content) == (304, b"")
    benches.order("rig-01", "A")
    changed = wait_for(lambda: (a := client.get(path, headers=known)).status_code == 200 and a, "the order")
    assert changed.headers["etag"] != first.headers["etag"]
    assert changed.headers["content-encoding"] == "gzip"
    plain = client.get(path, headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert plain.json() == changed.json()


def test_what_a_bench_says_in_another_form_is_not_known_and_keeps_nothing_from_being_shown(
    halls: Hall,
) -> None:
    client, benches = halls
    benches.beat("bench-1", outbox={"parcels": "many"}, lease_losses=-1, clock_skew_s="late")
    benches.states["rig-06"] = {"state": "busy", "run_id": {"id": 17}}
    benches.beat("bench-2")
    found = client.get("/api/benches/overview").raise_for_status().json()
    assert found[0]["undelivered"] is None
    assert found[0]["clock"] is None
    assert found[1]["rigs"][0]["run_id"] is None
    assert "calrig_orders_waiting" in client.get("/api/metrics").raise_for_status().text


def test_a_bench_that_never_spoke_is_there_without_rigs(halls: Hall) -> None:
    client, benches = halls
    benches.store.enrolment.add("bench-9", "hall 10")
    bench = client.get("/api/benches/overview").json()[-1]
    assert (bench["name"], bench["state"], bench["rigs"]) == ("bench-9", "never_seen", [])


def test_units_are_overdue_the_longest_first(halls: Hall) -> None:
    client, benches = halls
    lay(
        benches.store,
        ("AS-2", 30.0, gave(), {"rig": "rig-01"}),
        ("AS-1", 10.0, gave(), {"rig": "rig-02"}),
        ("AS-3", (datetime.now(UTC) - FIRST_DAY).days, gave(), {"rig": "rig-02"}),
    )
    found = client.get("/api/overdue").raise_for_status().json()
    assert [one["unit"] for one in found] == ["AS-1", "AS-2"]
    assert found[0]["due_says"] == "365 days after its last calibration."
    assert [one["unit"] for one in client.get("/api/overdue?limit=1").json()] == ["AS-1"]


Values = dict[tuple[str, ...], float]


def values(client: httpx.Client) -> Values:
    """Every sample, by its name and the values of its labels."""
    families = prometheus_text(client.get("/api/metrics").raise_for_status().text)
    return {(s.name, *s.labels.values()): s.value for family in families for s in family.samples}


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
