"""`calrig agent` as a process: its orders, its page, its end; and what it refuses to begin with."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from a_bench import ENDLESS, HandWritten
from click.testing import Result
from command_line import log_put_back, reason
from support import QUICK, ended, running_service, serving, wait_for
from typer.testing import CliRunner

from calrig.api.access import Access
from calrig.cli.main import app
from calrig.store import Store

SIMULATED = """
[[rig]]
name = "bench-1"
[rig.simulated]
seed = 1
time_scale = 20.0
stage = { velocity_dps = 60.0, acceleration_dps2 = 240.0, homing_velocity_dps = 30.0 }
"""


@contextmanager
def agent_process(centre: HandWritten, folder: Path, spool: Path, *options: str):
    """`calrig agent` with a simulated rig of its own; its process, once it says that it is there."""
    (folder / "calrig.toml").write_text(SIMULATED)
    named = ("--config", folder / "calrig.toml", "--spool", spool)
    process = subprocess.Popen(
        [sys.executable, "-m", "calrig", "agent", *map(str, named), *options],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "CALRIG_DB": centre.bench_url, "CALRIG_TOKEN": "a-token-of-the-bench"},
    )
    try:
        process.said = process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_run_outlives_the_death_of_its_program_as_interrupted(
    centre: HandWritten, tmp_path: Path, spool: Path
) -> None:
    with agent_process(centre, tmp_path, spool) as process:
        centre.in_touch()
        run_id = centre.order(plan=ENDLESS)
        wait_for(lambda: centre.delivered(run_id).poses, "poses")
        process.kill()
    with agent_process(centre, tmp_path, spool) as process:
        told = centre.ended(run_id)
        process.send_signal(signal.SIGTERM)
        assert process.wait() == 0
    assert told.states == ["queued", "running", "interrupted"]
    assert "ended before the run did" in told.events[-1]["data"]["error"]
    with Store.open(f"sqlite:///{spool}", writer=None) as store:
        n_poses = len(store.poses.of(run_id))
    assert sorted(set(told.poses)) == list(range(n_poses))


def test_its_own_page_starts_runs_and_leaves_the_rest_to_the_centre(
    centre: HandWritten, tmp_path: Path, spool: Path
) -> None:
    with agent_process(centre, tmp_path, spool, "--port", "0") as process:
        (url,) = re.findall(r"http://[\d.]+:\d+", process.said)
        with httpx.Client(
            base_url=url, headers={"Authorization": "Bearer a-token-of-the-bench"}, timeout=60
        ) as page:
            run = page.post("/api/runs", json={"unit": "AS-1", "plan": ENDLESS}).raise_for_status().json()
            wait_for(lambda: centre.delivered(run["id"]).poses, "poses at the centre")
            assert page.post(f"/api/runs/{run['id']}/void", json={"reason": "why"}).status_code == 409
            assert "calrig_lease_held 1.0" in page.get("/api/metrics").text
            assert page.post("/api/rigs/bench-1/stop").status_code == 200
            assert centre.ended(run["id"]).status == "aborted"
            assert httpx.get(f"{url}/api/runs").status_code == 401


@pytest.mark.parametrize(
    ("db", "status", "said"),
    [
        ("postgresql+psycopg://bench@centre.example/calrig", 1, "sslmode=verify-full"),
        ("postgresql+psycopg://bench@192.0.2.7/calrig?sslmode=require", 1, "sslmode=verify-full"),
        ("calrig.db", 2, "centre's database"),
    ],
)
def test_a_way_that_anybody_could_listen_to_is_refused(db: str, status: int, said: str) -> None:
    assert said in reason("agent", "--db", db, status=status)


def agent_with(tmp_path: Path, *options: str) -> Result:
    """`calrig agent` in this process, until it ends by itself."""
    (tmp_path / "calrig.toml").write_text(SIMULATED)
    named = ("--config", tmp_path / "calrig.toml", "--spool", tmp_path / "spool.db", *options)
    with log_put_back():
        return CliRunner().invoke(app, ["agent", *map(str, named)], catch_exceptions=False)


def test_the_owners_url_ends_it_with_a_reason(centre: HandWritten, tmp_path: Path) -> None:
    kept = tmp_path / "centre.url"
    kept.write_text(centre.url + "\n")
    done = agent_with(tmp_path, "--db-file", str(kept))
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert "owner of the centre's database" in line and "calrig agent enroll" in line


def test_a_password_in_the_arguments_gives_a_warning_that_names_the_other_ways(tmp_path: Path) -> None:
    away = "postgresql+psycopg://bench:secret@centre.example/calrig"
    done = agent_with(tmp_path, "--db", away)
    warning, refused = done.stderr.splitlines()
    assert "warning: --db contains a password" in warning
    assert all(way in warning for way in ("CALRIG_DB", "--db-file", "enroll"))
    assert "secret" not in warning + refused
    kept = tmp_path / "centre.url"
    kept.write_text(away)
    assert agent_with(tmp_path, "--db-file", str(kept)).stderr.splitlines() == [refused]


def test_a_file_without_the_url_is_named(tmp_path: Path) -> None:
    done = agent_with(tmp_path, "--db-file", str(tmp_path / "none.url"))
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert "none.url: cannot be read" in done.stderr


def test_help_tells_of_agent_and_enroll() -> None:
    told = CliRunner().invoke(app, ["agent", "--help"]).output
    assert "--spool" in told and "enroll" in told


def test_what_it_prints_is_one_line(centre: HandWritten, tmp_path: Path, spool: Path) -> None:
    with agent_process(centre, tmp_path, spool) as process:
        assert re.fullmatch(r"calrig \S+, rigs: bench-1\n", process.said)
        centre.in_touch()
        run_id = centre.order(plan={"elevations_deg": [0], "sweeps": 1, "settle_s": 0.1, "dwell_s": 0.5})
        assert centre.ended(run_id).status == "completed"
        result = centre.delivered(run_id).documents[-1]["run"]["result"]
        assert json.dumps(result["bias_deg"]) != "null"


@pytest.fixture
def client(rig, spool):
    with (
        running_service(spool, rig.settings) as service,
        serving(service, is_bench=True, access=Access(token="a-token-of-the-bench")) as client,
    ):
        client.headers["Authorization"] = "Bearer a-token-of-the-bench"
        yield client


def test_it_starts_shows_and_stops_runs(client) -> None:
    run = client.post("/api/runs", json={"unit": "AS-1", "plan": QUICK}).raise_for_status().json()
    assert ended(client, run["id"])["status"] == "completed"
    assert client.post("/api/rigs/bench-1/stop").status_code == 200
    assert client.get("/api/units/AS-1").status_code == 200


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/api/runs/1/void"),
        ("POST", "/api/runs/1/diagnosis"),
        ("POST", "/api/units/AS-1/calibrations/1/release"),
        ("PUT", "/api/limits"),
        ("POST", "/api/imports"),
        ("POST", "/api/users"),
        ("DELETE", "/api/units/AS-1"),
    ],
)
def test_it_leaves_the_rest_to_the_centre(client, method: str, path: str) -> None:
    refused = client.request(method, path, json={})
    assert refused.status_code == 409
    assert "centre" in refused.json()["detail"]


def test_it_asks_for_its_token_and_who_sent_the_page(client) -> None:
    assert client.post("/api/rigs/bench-1/stop", headers={"Authorization": ""}).status_code == 401
    elsewhere = {"Origin": "http://elsewhere.example"}
    assert client.post("/api/rigs/bench-1/stop", headers=elsewhere).status_code == 403
