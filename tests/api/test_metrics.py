"""`GET /api/metrics`: read with Prometheus's own parser, against a real run."""

from __future__ import annotations

import httpx
import pytest
from postgresql_server import ENGINE
from prometheus_client.openmetrics.parser import text_string_to_metric_families as open_metrics
from prometheus_client.parser import text_string_to_metric_families as prometheus_text
from support import QUICK, ended, running_service, serving, wait_for

import calrig
from calrig.runs.recorder import ServiceMetrics

Values = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def values(client: httpx.Client) -> Values:
    """Every sample by name and labels."""
    families = prometheus_text(client.get("/api/metrics").raise_for_status().text)
    return {(s.name, tuple(sorted(s.labels.items()))): s.value for f in families for s in f.samples}


def of(name: str, **labels: str) -> tuple[str, tuple[tuple[str, str], ...]]:
    return name, tuple(sorted(labels.items()))


def test_a_run_is_counted(client: httpx.Client):
    before = values(client)
    assert before[of("calrig_samples_total", rig="bench-1")] == 0
    assert before[of("calrig_runs", status="completed")] == 0
    assert before[of("calrig_rig_state", rig="bench-1", state="idle")] == 1
    begun = client.post("/api/runs", json={"unit": "AS-1", "plan": QUICK}).json()
    assert values(client)[of("calrig_rig_state", rig="bench-1", state="busy")] == 1
    assert ended(client, begun["id"])["status"] == "completed"
    of_its_end = of("calrig_runs_ended_total", rig="bench-1", status="completed")
    after = wait_for(lambda: (v := values(client)).get(of_its_end) and v, "count of what the store has")
    assert after[of("calrig_poses_total", rig="bench-1")] == 6
    stored = sum(pose["n_samples"] for pose in client.get(f"/api/runs/{begun['id']}/poses").json())
    assert after[of("calrig_samples_total", rig="bench-1")] > stored
    assert after[of_its_end] == 1
    assert after[of("calrig_runs", status="completed")] == 1
    assert after[of("calrig_store_up")] == 1
    assert after[of("calrig_store_size_bytes")] >= before[of("calrig_store_size_bytes")] > 0
    if ENGINE == "sqlite":  # a server's disk is another machine's
        assert after[of("calrig_store_free_bytes")] > 0
    assert after[of("calrig_uptime_seconds")] > before[of("calrig_uptime_seconds")]
    assert after[of("calrig_build_info", version=calrig.__version__)] == 1


def test_faults_are_counted_by_kind_as_the_run_has_them(launch_rig, store_path):
    rig = launch_rig("bench-1", board={"fault": "corrupt"})
    with running_service(store_path, rig) as service, serving(service) as client:
        begun = client.post("/api/runs", json={"unit": "AS-1", "plan": QUICK}).json()
        run = ended(client, begun["id"])

        def counted() -> dict[str, float]:
            said = values(client).items()
            return {dict(labels)["kind"]: n for (name, labels), n in said if name == "calrig_faults_total"}

        wait_for(lambda: counted() == run["faults"], "counts of what the store has")
    assert run["faults"]["crc"] > 0


def test_a_resumed_run_counts_only_its_new_faults():
    meter = ServiceMetrics(["bench-1"])
    run = meter.of_run("bench-1", {"crc": 2})  # of a resumed run that had seen two
    for totals in ({"crc": 2}, {"crc": 5, "late_reply": 1}, {"crc": 5, "late_reply": 1}):
        run.faults(totals)

    def counted(kind: str) -> float | None:
        return meter.registry.get_sample_value("calrig_faults_total", {"rig": "bench-1", "kind": kind})

    assert (counted("crc"), counted("late_reply")) == (3, 1)


def test_two_services_count_apart():
    one, other = ServiceMetrics(["bench-1"]), ServiceMetrics(["bench-1"])
    one.of_run("bench-1").samples(5)
    assert one.registry.get_sample_value("calrig_samples_total", {"rig": "bench-1"}) == 5
    assert other.registry.get_sample_value("calrig_samples_total", {"rig": "bench-1"}) == 0


def test_event_clients_are_counted_while_they_listen(client: httpx.Client):
    begun = client.post("/api/runs", json={"unit": "AS-1", "plan": {**QUICK, "sweeps": 100}}).json()
    assert values(client)[of("calrig_event_clients")] == 0
    with client.stream("GET", f"/api/runs/{begun['id']}/events"):
        assert values(client)[of("calrig_event_clients")] == 1
    wait_for(lambda: values(client)[of("calrig_event_clients")] == 0, "the client's leaving")
    client.post(f"/api/runs/{begun['id']}/abort")
    of_its_end = of("calrig_runs_ended_total", rig="bench-1", status="aborted")
    assert wait_for(lambda: values(client).get(of_its_end), "count of what the store has") == 1


def test_no_label_grows_with_runs_or_units(shared_client: httpx.Client):
    labels = {name for _, pairs in values(shared_client) for name, _ in pairs}
    assert labels == {"rig", "state", "status", "version"}


def test_open_metrics_where_it_is_asked_for(shared_client: httpx.Client):
    accept = {"Accept": "application/openmetrics-text; version=1.0.0"}
    answer = shared_client.get("/api/metrics", headers=accept).raise_for_status()
    assert answer.headers["content-type"].startswith("application/openmetrics-text")
    names = [family.name for family in open_metrics(answer.text)]
    assert {"calrig_samples", "calrig_build", "calrig_runs"} <= set(names)
    assert answer.text.endswith("# EOF\n")
    assert shared_client.get("/api/metrics").headers["content-type"].startswith("text/plain; version=0.0.4")


def read_only_from_now_on(raw, *_):
    """A connection as the pool gives it out."""
    if ENGINE == "sqlite":
        raw.execute("PRAGMA query_only = ON")
    else:
        raw.read_only = True


@pytest.mark.parametrize(("trouble", "status"), [("read-only", 503), ("damaged", 500)])
def test_a_store_that_fails_is_answered_with_the_sentence(client, service, trouble, status):
    imported = client.post(
        "/api/imports", data={"unit": "A"}, files={"file": ("p.csv", b"target_deg,reading_deg\n0,1\n10,11\n")}
    ).json()
    engine = service.store._database._engine
    if trouble == "damaged":
        with engine.connect() as connection:  # a digit of a reading, as a worn disk changes it
            connection.exec_driver_sql("UPDATE pose SET reading_deg = 1.5 WHERE pose_index = 0")
            connection.commit()
        answer = client.get(f"/api/runs/{imported['id']}/poses")
        words = "it is damaged: "
    else:
        from sqlalchemy import event

        event.listen(engine, "checkout", read_only_from_now_on)
        answer = client.post(f"/api/runs/{imported['id']}/void", json={"reason": "trial"})
        words = "read-only: make both writable" if ENGINE == "sqlite" else "the server takes no writes"
    assert answer.status_code == status
    assert words in answer.json()["detail"]
    assert values(client)[of("calrig_store_up")] == 1
