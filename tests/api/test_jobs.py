"""Heavy work is done beside the service, within bounds; a job that nobody waits for tells how far it is."""

from __future__ import annotations

import logging
import random
import tempfile
from contextlib import ExitStack, closing
from http.client import HTTPConnection
from typing import Any

import httpx
import pytest
from endless_work import SEEN, for_ever, see, watched, working
from support import PATIENCE_S, POSES, imported, running_service, serving, wait_for

from calrig.analysis import diagnoses, stored_runs
from calrig.api import imports, job, jobs
from calrig.processes import pool

TARGETS = [x for x in range(-60, 61, 10) for _ in range(2)]
RANDOM = random.Random(1)
MANY = "target_deg,reading_deg\n" + "".join(f"{x},{x + 0.8 + RANDOM.gauss(0, 0.03):.4f}\n" for x in TARGETS)
LOG = "time_s,gyro_x_dps\n" + "".join(f"{k / 100},{RANDOM.gauss(0, 0.1):.5f}\n" for k in range(3000))


@pytest.fixture
def _nobody_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even two seconds."""
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)


def begun(client: httpx.Client, path: str, **request: Any) -> str:
    """The path of the job that a request has begun."""
    answer = client.post(path, params={"wait": "false"}, **request)
    assert answer.status_code == 202, answer.text
    assert answer.headers["Location"] == f"/api/jobs/{answer.json()['id']}"
    return str(answer.headers["Location"])


def over(client: httpx.Client, path: str) -> list[dict[str, Any]]:
    """What a job says of itself, again and again until it has ended."""
    said: list[dict[str, Any]] = []

    def ended() -> bool:
        said.append(client.get(path).raise_for_status().json())
        see(said[-1]["fraction"])
        return said[-1]["state"] not in ("queued", "running")

    wait_for(ended, "end of the job")
    return said


@pytest.mark.usefixtures("_nobody_waits")
def test_a_diagnosis_tells_how_far_it_is_and_where_it_is_found(shared_client, monkeypatch):
    SEEN.unlink(missing_ok=True)
    monkeypatch.setattr(diagnoses, "traced", watched)
    run_id = imported(shared_client, "AS-1", MANY)["id"]
    said = over(shared_client, begun(shared_client, f"/api/runs/{run_id}/diagnosis", json={}))
    fractions = [one["fraction"] for one in said]
    assert fractions == sorted(fractions)
    assert {k / 5 for k in range(6)} == set(fractions), "one search over all poses, four in folds"
    path = f"/api/runs/{run_id}/diagnosis"
    assert {**said[-1], "id": ""} == {
        "id": "", "state": "done", "fraction": 1.0, "result": path, "error": None,
        "error_status": None,
    }  # fmt: skip
    found = shared_client.get(path).json()
    assert found["n_poses"] == len(TARGETS)
    assert shared_client.post(path, json={}).json() == found, "as it is answered to who waits"


@pytest.mark.usefixtures("_nobody_waits")
def test_a_job_that_is_cancelled_ends_its_process_and_keeps_nothing(shared_client, monkeypatch):
    run_id = imported(shared_client, "AS-1")["id"]
    monkeypatch.setattr(diagnoses, "traced", for_ever)
    path = begun(shared_client, f"/api/runs/{run_id}/diagnosis", json={})
    wait_for(working, "its beginning")
    queued = begun(shared_client, "/api/imports", files={"file": ("p.csv", POSES)}, data={"unit": "B"})
    assert shared_client.get(path).json()["state"] == "running"
    assert shared_client.get(queued).json()["state"] == "queued"
    assert shared_client.get(queued).json()["fraction"] == 0.0
    for one in (queued, path, path):
        assert shared_client.delete(one).raise_for_status().json()["state"] == "cancelled"
    assert not working()
    assert shared_client.get(path).json() == shared_client.delete(path).json()
    assert shared_client.get(f"/api/runs/{run_id}/diagnosis").status_code == 404
    assert shared_client.get("/api/runs", params={"unit": "B"}).json()["items"] == []


@pytest.mark.usefixtures("_nobody_waits")
def test_what_fails_says_why_as_it_would_to_who_waits(shared_client):
    request: dict[str, Any] = {"files": {"file": ("p.csv", "target_deg\nx\n")}, "data": {"unit": "B"}}
    failed = over(shared_client, begun(shared_client, "/api/imports", **request))[-1]
    assert (failed["state"], failed["result"]) == ("failed", None)
    refused = shared_client.post("/api/imports", **request)
    assert (refused.status_code, refused.json()["detail"]) == (failed["error_status"], failed["error"])


@pytest.mark.usefixtures("_nobody_waits")
def test_a_defect_is_in_the_log_with_its_job(shared_client, monkeypatch, caplog):
    run_id = imported(shared_client, "AS-1")["id"]
    monkeypatch.setattr(diagnoses, "traced", int)
    path = begun(shared_client, f"/api/runs/{run_id}/diagnosis", json={})
    assert over(shared_client, path)[-1]["error"] == "calrig failed inside; the service's log says where"
    (line,) = [one for one in caplog.records if one.name == "calrig.api.job"]
    assert line.levelno == logging.ERROR
    assert f"(POST /api/runs/{run_id}/diagnosis): failed" in line.getMessage()
    assert line.exc_info is not None
    assert line.fields.keys() == {"job", "state", "duration_s"}  # type: ignore[attr-defined]


@pytest.mark.usefixtures("_nobody_waits")
def test_what_is_kept_nowhere_else_is_kept_with_its_job_for_a_while(shared_client, monkeypatch):
    request = {"files": {"file": ("log.csv", LOG)}}
    path = begun(shared_client, "/api/noise", **request)
    assert shared_client.get(f"{path}/result").status_code == 409
    done = over(shared_client, path)[-1]
    assert done["result"] == f"{path}/result"
    kept = shared_client.get(done["result"])
    assert kept.headers["Content-Type"] == "application/json"
    again = shared_client.post("/api/noise", **request).json()
    assert {**kept.json(), "id": again["id"]} == again  # each is a study of its own
    monkeypatch.setattr(job, "MOST_BYTES", 0)
    later = begun(shared_client, "/api/noise", **request)
    over(shared_client, later)
    assert shared_client.get(f"{later}/result").status_code == 200
    gone = shared_client.get(path)
    assert gone.status_code == 404
    assert "unknown job" in gone.json()["detail"]


@pytest.mark.usefixtures("_nobody_waits")
def test_the_oldest_of_many_that_ended_are_forgotten(shared_client, monkeypatch):
    monkeypatch.setattr(job, "MOST_FINISHED", 2)
    request: dict[str, Any] = {"files": {"file": ("p.csv", POSES)}, "data": {"unit": "C"}}
    paths = []
    for _ in range(4):
        paths.append(begun(shared_client, "/api/imports", **request))
        assert over(shared_client, paths[-1])[-1]["result"].startswith("/api/runs/")
    assert [shared_client.get(path).status_code for path in paths] == [404, 404, 200, 200]


def test_what_is_done_soon_enough_is_answered_as_ever(shared_client, monkeypatch):
    monkeypatch.setattr(jobs, "AT_ONCE_S", PATIENCE_S)  # two seconds are over soon on a busy machine
    file = {"file": ("p.csv", POSES)}
    answer = shared_client.post("/api/imports", files=file, data={"unit": "D"}, params={"wait": "false"})
    assert (answer.status_code, answer.json()["unit"]) == (201, "D")


def test_no_job_of_another_life_of_the_service_is_known(rig, store_path, monkeypatch):
    monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)
    monkeypatch.setattr(diagnoses, "traced", for_ever)
    with running_service(store_path, rig) as service:
        with serving(service, own_processes=True) as client:
            run_id = imported(client, "AS-1")["id"]
            path = begun(client, f"/api/runs/{run_id}/diagnosis", json={})
            wait_for(working, "its beginning")
        assert not working(), "it ends with the service"
    with running_service(store_path, rig) as service, serving(service) as client:
        assert client.get(path).status_code == client.delete(path).status_code == 404
        assert client.get("/api/jobs/1").status_code == 404


def asking(client: httpx.Client, run: dict[str, Any]) -> closing[HTTPConnection]:
    """Somebody who asks for a diagnosis and leaves at the end of the block."""
    connection = HTTPConnection(client.base_url.host, client.base_url.port or 80)
    kind = {"Content-Type": "application/json"}
    connection.request("POST", f"/api/runs/{run['id']}/diagnosis", b"{}", kind)
    return closing(connection)


def test_a_diagnosis_stops_when_its_client_leaves(shared_client, monkeypatch):
    run = imported(shared_client, "AS-1")
    monkeypatch.setattr(diagnoses, "traced", for_ever)
    with asking(shared_client, run):
        wait_for(working, "its beginning")
    wait_for(lambda: not working(), "end of the work")


def test_more_than_may_wait_is_429_and_told_when_to_come_back(shared_client, monkeypatch):
    run = imported(shared_client, "AS-1")
    monkeypatch.setattr(diagnoses, "traced", for_ever)
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


def test_what_one_user_has_waiting_refuses_nobody_elses(rig, tmp_path, monkeypatch):
    monkeypatch.setattr(diagnoses, "traced", for_ever)
    monkeypatch.setattr(pool, "MOST_WAITING", 0)
    with running_service(tmp_path / "calrig.db", rig) as service:
        _, adas = service.store.users.add("ada", "admin")
        _, bens = service.store.users.add("ben", "operator")
        as_ada, as_ben = ({"Authorization": f"Bearer {token}"} for token in (adas, bens))
        with serving(service, own_processes=True) as client:
            client.headers.update(as_ada)
            path = f"/api/runs/{imported(client, 'AS-1')['id']}/diagnosis"
            monkeypatch.setattr(jobs, "AT_ONCE_S", 0.0)
            jobs_of_ada = [begun(client, path, json={}) for _ in range(pool.Processes().slots)]
            assert client.post(path, json={}).status_code == 429
            job_of_ben = begun(client, path, json={}, headers=as_ben)
            assert client.get(job_of_ben).json()["state"] == "queued"
            for one in [*jobs_of_ada, job_of_ben]:
                client.delete(one).raise_for_status()


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
