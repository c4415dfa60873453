"""What takes the processor is done beside the service, while somebody waits for it, and within bounds."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack, closing
from http.client import HTTPConnection
from typing import Any

import httpx
from endless_work import for_ever, working
from support import imported, wait_for

from calrig.analysis import diagnoses, stored_runs
from calrig.api import imports
from calrig.processes import pool


def asking(client: httpx.Client, run: dict[str, Any]) -> closing[HTTPConnection]:
    """Somebody who asks for a diagnosis and leaves at the end of the block."""
    connection = HTTPConnection(client.base_url.host, client.base_url.port or 80)
    kind = {"Content-Type": "application/json"}
    connection.request("POST", f"/api/runs/{run['id']}/diagnosis", b"{}", kind)
    return closing(connection)


def test_a_diagnosis_stops_when_its_client_leaves(shared_client, monkeypatch):
    run = imported(shared_client, "AS-1")
    monkeypatch.setattr(diagnoses, "trace", for_ever)
    with asking(shared_client, run):
        wait_for(working, "its beginning")
    wait_for(lambda: not working(), "end of the work")


def test_more_than_may_wait_is_429_and_told_when_to_come_back(shared_client, monkeypatch):
    run = imported(shared_client, "AS-1")
    monkeypatch.setattr(diagnoses, "trace", for_ever)
    monkeypatch.setattr(pool, "MOST_WAITING", 0)
    slots = pool.Processes().slots
    with ExitStack() as others:
        for _ in range(slots):
            others.enter_context(asking(shared_client, run))
        wait_for(lambda: len(working()) == slots, "all processes at work")
        monkeypatch.setattr(imports, "on_disk", None)  # nothing is laid there in vain
        answer = shared_client.post("/api/imports", files={"file": ("p.csv", "x")}, data={"unit": "A"})
    assert answer.status_code == 429
    assert answer.headers["Retry-After"] == "5"
    assert "try again later" in answer.json()["detail"]


def test_a_diagnosis_of_too_many_poses_is_refused_and_says_how_many_it_takes(shared_client, monkeypatch):
    run = imported(shared_client, "AS-1")
    monkeypatch.setattr(stored_runs, "MOST_POSES", 3)
    answer = shared_client.post(f"/api/runs/{run['id']}/diagnosis", json={})
    assert answer.status_code == 422
    assert "at most 3 poses" in answer.json()["detail"]


def test_an_upload_that_this_machine_has_no_room_for_is_503_and_says_where(
    shared_client, monkeypatch, tmp_path
):
    gone = tmp_path / "no such folder"
    monkeypatch.setattr(tempfile, "tempdir", str(gone))
    for size in (10, 2_000_000):  # a small one is laid there for the other process, a large one as it comes
        file = {"file": ("p.csv", b"target_deg,reading_deg\n" + b"1,1\n" * size)}
        answer = shared_client.post("/api/imports", files=file, data={"unit": "A"})
        assert answer.status_code == 503, answer.text
        assert str(gone) in answer.json()["detail"]
        assert "make room there" in answer.json()["detail"]


def test_poses_come_in_batches_as_they_would_at_once(shared_client):
    rows = "".join(f"{k % 90},{k % 90 + 0.5},{k}\n" for k in range(2500))
    run = imported(shared_client, "AS-2", f"target_deg,reading_deg,time_s\n{rows}")
    poses = shared_client.get(f"/api/runs/{run['id']}/poses").json()
    assert [(pose["index"], pose["time_s"]) for pose in poses] == [(k, k) for k in range(2500)]
    text = shared_client.get(f"/api/runs/{run['id']}/poses", params={"format": "csv"}).text
    again = imported(shared_client, "AS-3", text)
    assert again["result"] == run["result"]
