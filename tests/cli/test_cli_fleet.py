"""`calrig fleet` and `calrig export --parquet`: a document for programs, a table for people."""

from __future__ import annotations

import json
import socket
import sqlite3
import sys
from contextlib import closing

import numpy as np
import pytest
from command_line import calrig, reason
from shared_processes import shared_workers

from calrig.analysis import fleet
from calrig.store import Store


@pytest.fixture
def _processes_are_there(monkeypatch):
    """Calrig's own, without their start."""
    monkeypatch.setattr(fleet, "own_processes", shared_workers)


@pytest.fixture
def runs(folder) -> list[str]:
    """Ids of two runs of units on a rig, the first with a backlash of 0.3°."""
    rng = np.random.default_rng(3)
    theta_deg = np.tile(np.concatenate([np.linspace(-60, 60, 13), np.linspace(60, -60, 13)]), 2)
    approach = np.tile(np.repeat([1, -1], 13), 2)
    made = []
    for unit, backlash_deg in (("A", 0.3), ("B", 0.0)):
        reading_deg = theta_deg + backlash_deg / 2.0 * approach + rng.normal(0.0, 0.03, len(theta_deg))
        rows = [
            f"{t},{r:.5f},{a},{5.0 * k}"
            for k, (t, r, a) in enumerate(zip(theta_deg, reading_deg, approach, strict=True))
        ]
        (folder / "run.csv").write_text("\n".join(["target_deg,reading_deg,approach,time_s", *rows]))
        made.append(calrig("import", "run.csv", "--unit", unit, "--rig", "bench-1").stdout.strip())
    return made


@pytest.fixture(scope="module")
def scheduler():
    """Address of a Dask scheduler with one worker; both are in this process, and are spoken to over TCP."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.usefixtures("_processes_are_there")
def test_the_document_tells_what_changed_and_each_rigs_map(runs, scheduler):
    found = json.loads(calrig("fleet", "--json").stdout)
    assert list(found) == ["runs", "changed", "failed", "rigs", "duration_s"]
    assert found["runs"] == 2
    assert found["changed"] == [{"run_id": runs[0], "verdict_before": None, "verdict_now": "named"}]
    (rig,) = found["rigs"]
    assert (rig["rig"], rig["units"]) == ("bench-1", 2)
    again = calrig("fleet", "--scheduler", scheduler).stdout
    assert "2 runs" in again
    assert runs[0] in again


@pytest.mark.usefixtures("_processes_are_there")
def test_a_failed_run_is_a_line_and_the_report_is_made(runs, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with closing(sqlite3.connect("calrig.db")) as store:
        store.execute("UPDATE pose SET reading_deg = 1 WHERE pose_index = 2 AND run_id = 2")
        store.commit()
    told = calrig("fleet").stdout
    assert "failed, and is tried again" in told
    assert "pose 2 of run" in told
    assert runs[0] in told


def test_without_dask_a_scheduler_cannot_be_named_and_calrigs_own_processes_do_it(runs, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert json.loads(calrig("fleet", "--json").stdout)["changed"][0]["verdict_now"] == "named"
    calrig("diagnose", runs[0])
    with Store.open("sqlite:///calrig.db", writer="tests") as store:
        store.amendments.exclude_pose(runs[0], 3, "bumped", result=None)
    said = reason("fleet", "--scheduler", "tcp://127.0.0.1:8786", status=1)
    assert said == "calrig: --scheduler needs Dask: pip install 'calrig[fleet]'"


def test_a_schedulers_workers_do_it(runs, scheduler):
    found = calrig("fleet", "--json", "--scheduler", scheduler)
    assert json.loads(found.stdout)["changed"][0]["run_id"] == runs[0]


def test_a_scheduler_that_does_not_answer_is_one_line(runs, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("calrig.cli.fleet.PATIENCE_S", 1.0)
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
    said = reason("fleet", "--scheduler", f"tcp://127.0.0.1:{port}", status=1)
    assert f"tcp://127.0.0.1:{port}: no Dask scheduler" in said


def test_exported_poses_are_screened_in_the_stores_place(runs, scheduler):
    pytest.importorskip("pyarrow")
    assert calrig("export", "--parquet", "poses").stdout == "poses: 2 runs, 104 poses in 1 files\n"
    found = json.loads(
        calrig("fleet", "--poses", "poses", "--out", "found.db", "--json", "--scheduler", scheduler).stdout
    )
    assert [change["run_id"] for change in found["changed"]] == [runs[0]]
    assert "name another folder" in reason("export", "--parquet", "poses", status=2)
    assert "name no run" in reason("export", runs[0], "--parquet", "others", status=2)
    assert "no Parquet file" in reason("fleet", "--poses", "absent", "--out", "found.db", status=2)


def test_a_store_that_is_taken_names_the_other_way(runs, scheduler):
    with Store.open("sqlite:///calrig.db", writer="serve") as taken:
        taken.answers_at("http://127.0.0.1:9")
        said = reason("fleet", status=1)
        assert "with --out FILE" in said
        assert "--server" not in said
        calrig("fleet", "--out", "found.db", "--scheduler", scheduler)
