"""A centre over HTTP: its rigs are its benches', and any number of processes serve one database."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import httpx
import psycopg
import pytest
from support import PATIENCE_S, QUICK, ended, program, serving, wait_for
from table_bench import MakeCentre, Measured, TableBench

import calrig
from calrig.centre.service import CentreService
from calrig.plan import Plan
from calrig.store import Store


def _server_url(url: str) -> str:
    return url.replace("postgresql+psycopg://", "postgresql://")


def test_the_rigs_of_a_centre_are_those_of_its_benches(centre: CentreService, bench: TableBench, plan: Plan):
    with serving(centre) as client:
        (rig,) = client.get("/api/rigs").json()
        assert {**rig, "last_seen_at": None} == {
            "name": "bench-1",
            "stage": "smc100",
            "imu": "calrig",
            "simulated": False,
            "state": "idle",
            "run_id": None,
            "clamp": None,
            "bench": "hall-2",
            "hall": "north",
            "last_seen_at": None,
            "stop_asked_at": None,
        }
        run_id = client.post("/api/runs", json={"unit": "A", "plan": QUICK}).json()["id"]
        assert [(rig["state"], rig["run_id"]) for rig in client.get("/api/rigs").json()] == [("busy", run_id)]

        bench.beat(ago_s=11)
        (rig,) = client.get("/api/rigs").json()
        assert (rig["state"], rig["run_id"]) == ("offline", run_id)
        assert 'calrig_rig_state{rig="bench-1",state="offline"} 1.0' in client.get("/api/metrics").text


def test_a_busy_rig_is_409_unless_the_run_may_queue(centre: CentreService, bench: TableBench):
    with serving(centre) as client:
        first = client.post("/api/runs", json={"unit": "A", "plan": QUICK})
        second = client.post("/api/runs", json={"unit": "B", "plan": QUICK})
        third = client.post("/api/runs", json={"unit": "B", "plan": QUICK, "queue": True})

        assert [answer.status_code for answer in (first, second, third)] == [201, 409, 201]
        assert '"queue": true' in second.json()["detail"]
        assert third.json()["status"] == "queued"
        stopped = client.post(f"/api/runs/{third.json()['id']}/abort").json()
        assert stopped["status"] == "aborted"


def test_what_one_process_unpacks_the_watchers_of_another_see(
    make_centre: MakeCentre, bench: TableBench, measured: Measured
):
    run_id = measured.run.id
    with serving(make_centre()) as one, serving(make_centre()) as other:
        bench.deliver(run_id, measured.parcels[:1])
        wait_for(lambda: one.get(f"/api/runs/{run_id}").status_code == 200, "run")
        told: list[dict[str, int]] = []
        began = threading.Event()

        def watch() -> None:
            with other.stream("GET", f"/api/runs/{run_id}/events", timeout=PATIENCE_S) as events:
                for line in events.iter_lines():
                    if line.startswith("id:"):
                        told.append(int(line.removeprefix("id:")))
                        began.set()

        watching = threading.Thread(target=watch, daemon=True)
        watching.start()
        assert began.wait(PATIENCE_S)
        for parcel in measured.parcels[1:]:
            bench.deliver(run_id, [parcel])
        watching.join(PATIENCE_S)

        assert told == [event.seq for event in measured.events]
        assert ended(one, run_id)["result"] == other.get(f"/api/runs/{run_id}").json()["result"]
        assert len(one.get("/api/units/A/calibrations").json()) == 1


def test_a_watcher_goes_on_after_the_connection_that_tells_of_news_was_cut(
    centre: CentreService, bench: TableBench, url: str, measured: Measured
):
    bench.deliver(measured.run.id, measured.parcels[:1])
    wait_for(lambda: centre.store.runs.get(measured.run.id), "run")
    woken = threading.Event()
    centre.bus.subscribe(measured.run.id, woken.set)
    cut = (
        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
        "WHERE query LIKE 'LISTEN%' AND datname = current_database()"
    )
    with psycopg.connect(_server_url(url), autocommit=True) as server:
        assert server.execute(cut).fetchall()

    bench.deliver(measured.run.id, measured.parcels[1:])
    assert woken.wait(PATIENCE_S)
    assert centre.wait(measured.run.id, PATIENCE_S).status == "completed"


OF_EARLIER_VERSIONS = """
    CREATE TYPE procrastinate_job_status AS ENUM ('todo', 'doing');
    CREATE TABLE procrastinate_workers (id bigint PRIMARY KEY);
    CREATE TABLE procrastinate_jobs (
        id bigint PRIMARY KEY, status procrastinate_job_status,
        worker_id bigint REFERENCES procrastinate_workers
    );
    CREATE TABLE procrastinate_events (job_id bigint REFERENCES procrastinate_jobs);
    CREATE TABLE procrastinate_periodic_defers (job_id bigint REFERENCES procrastinate_jobs);
    CREATE FUNCTION procrastinate_fetch_job_v2() RETURNS procrastinate_jobs LANGUAGE sql
        AS 'SELECT * FROM procrastinate_jobs';
    CREATE FUNCTION procrastinate_notify_v1() RETURNS trigger LANGUAGE plpgsql AS 'BEGIN RETURN NULL; END';
    CREATE TRIGGER procrastinate_notify AFTER INSERT ON procrastinate_jobs
        FOR EACH ROW EXECUTE FUNCTION procrastinate_notify_v1();
    INSERT INTO procrastinate_jobs VALUES (1, 'todo', NULL);
    DROP FUNCTION calrig_tell_order_v1 CASCADE;
"""
LEFT_OVER = """
    SELECT relname FROM pg_class WHERE starts_with(relname, 'procrastinate_')
    UNION ALL SELECT proname FROM pg_proc WHERE starts_with(proname, 'procrastinate_')
    UNION ALL SELECT typname FROM pg_type WHERE starts_with(typname, 'procrastinate_')
"""


def test_the_triggers_are_made_once_and_the_queues_of_earlier_versions_are_dropped(
    url: str, bench: TableBench, make_centre: MakeCentre, plan: Plan
):
    with psycopg.connect(_server_url(url), autocommit=True) as server:
        server.execute(OF_EARLIER_VERSIONS)
        Store.open(url, writer="tests").close()
        Store.open(url, writer="tests").close()
        assert server.execute(LEFT_OVER).fetchall() == []

        server.execute("LISTEN calrig_order")
        make_centre().start(unit="A", plan=plan)
        told = [notice.payload for notice in server.notifies(timeout=PATIENCE_S, stop_after=1)]
    assert told == ["hall-2"]


def test_the_stop_of_a_process_does_not_end_what_benches_do(
    make_centre: MakeCentre, bench: TableBench, plan: Plan
):
    first = make_centre()
    run_id = first.start(unit="A", plan=plan).id
    first.close()
    first.close()  # as a server that goes does, twice

    assert make_centre().run(run_id).status == "queued"
    assert bench.take(run_id, 1) == "begin"


CALRIG = (sys.executable, "-m", "calrig")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(calrig.__file__).parents[1])}


def test_calrig_serve_on_a_database_is_a_centre(url: str, bench: TableBench, tmp_path: Path):
    with program(*CALRIG, "serve", "--port", "0", "--db", url, cwd=tmp_path, env=ENVIRONMENT) as process:
        assert process.stdout is not None
        said = process.stdout.readline()
        assert "rigs: bench-1" in said
        at = re.search(r"http://\S+?:\d+", said)
        assert at is not None
        with httpx.Client(base_url=at[0], timeout=PATIENCE_S) as client:
            assert [rig["bench"] for rig in client.get("/api/rigs").json()] == ["hall-2"]
            assert client.post("/api/runs", json={"unit": "A", "plan": QUICK}).json()["status"] == "queued"
        process.terminate()
        assert process.wait(PATIENCE_S) == 0
    assert len(bench.orders()) == 1


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("serve", "--port", "0", "--config", "calrig.toml"), "'bench-1', and a centre has none of its own"),
        (("run", "--unit", "A"), "is a centre's, whose benches carry runs out"),
    ],
    ids=["serve", "run"],
)
def test_a_centre_has_no_rigs_of_its_own(url: str, tmp_path: Path, arguments: tuple[str, ...], why: str):
    devices = 'stage = { driver = "smc100", port = "/dev/a" }\nimu = { driver = "calrig", port = "/dev/b" }'
    (tmp_path / "calrig.toml").write_text(f'[[rig]]\nname = "bench-1"\n{devices}\n')

    done = subprocess.run(
        [*CALRIG, *arguments, "--db", url],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=ENVIRONMENT,
        check=False,
    )

    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert why in line


def test_a_list_of_units_is_carried_out_by_benches(centre: CentreService, bench: TableBench) -> None:
    with serving(centre) as client:
        body = {"units": ["L-1", "L-2"], "rigs": ["bench-1"], "plan": QUICK}
        path = f"/api/batches/{client.post('/api/batches', json=body).raise_for_status().json()['id']}"
        begun = client.post(f"{path}/start", json={"rig": "bench-1", "unit": "L-1"}).raise_for_status().json()
        (rig,) = begun["rigs"]
        assert (rig["on"]["state"], rig["status"], rig["next"]["unit"]) == ("running", "queued", "L-2")
        assert client.post(f"{path}/start", json={"rig": "bench-1", "unit": "L-2"}).status_code == 409
        client.post(f"/api/runs/{rig['on']['run_id']}/abort").raise_for_status()
        (rig,) = client.get(path).json()["rigs"]
        assert (rig["on"]["unit"], rig["on"]["state"]) == ("L-1", "waiting")
