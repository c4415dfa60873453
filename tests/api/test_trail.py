"""The trail over HTTP: whoever is known by name is who did it, whatever a request says."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from postgresql_server import ENGINE
from support import QUICK, ended, imported, serving, wait_for

from calrig.api.access import Access
from calrig.store import trail


@pytest.fixture
def ada(service: Any) -> Iterator[httpx.Client]:
    """A releaser."""
    _, token = service.store.users.add("ada", "releaser")
    with serving(service, access=Access("the-benches-of-building-4")) as client:
        client.headers["Authorization"] = f"Bearer {token}"
        yield client


OF_CALIBRATIONS = ("drafted", "released")


def told(client: httpx.Client, **asked: Any) -> list[tuple[Any, ...]]:
    """What was done, but for the calibrations that it led to."""
    entries = client.get("/api/trail", params=asked).raise_for_status().json()["entries"]
    named = [(entry["what"], entry["who"], entry["unit"], entry["run_id"]) for entry in entries]
    return [entry for entry in named if entry[0] not in OF_CALIBRATIONS]


def test_who_is_known_by_name_did_it_whatever_the_request_says(ada: httpx.Client) -> None:
    body = {"unit": "A", "plan": QUICK, "operator": "eve"}
    started = ada.post("/api/runs", json=body).raise_for_status().json()
    ada.post(f"/api/runs/{started['id']}/abort").raise_for_status()
    taken = imported(ada, "B", operator="eve")
    assert (started["operator"], taken["operator"]) == ("ada", "ada")
    assert taken["provenance"]["operator"] == "ada"
    of_first, of_second = ("ada", "A", started["id"]), ("ada", "B", taken["id"])
    entries = {entry for entry in told(ada) if entry[0] != "user_added"}
    assert entries == {("started", *of_first), ("aborted", *of_first), ("imported", *of_second)}


def test_a_pause_and_its_end_are_told(ada: httpx.Client) -> None:
    run = ada.post("/api/runs", json={"unit": "A", "plan": QUICK}).raise_for_status().json()
    for act, status in (("pause", "paused"), ("resume", "running")):
        ada.post(f"/api/runs/{run['id']}/{act}").raise_for_status()
        wait_for(lambda status=status: ada.get(f"/api/runs/{run['id']}").json()["status"] == status, status)
    told_of_it = [what for what, who, _, of in told(ada) if (who, of) == ("ada", run["id"])]
    assert told_of_it == ["started", "paused", "resumed"]
    ada.post(f"/api/runs/{run['id']}/abort").raise_for_status()


def test_a_stop_that_aborts_runs_is_told_with_who_pressed_it(ada: httpx.Client) -> None:
    running, waiting = (
        ada.post("/api/runs", json={"unit": "A", "plan": QUICK, "queue": True})
        .raise_for_status()
        .json()["id"]
        for _ in range(2)
    )
    ada.post("/api/rigs/bench-1/stop").raise_for_status()
    ended(ada, running)  # the stage stands once the stop is answered; the run writes its end a moment later
    aborted = [(who, of) for what, who, _, of in told(ada) if what == "aborted"]
    assert sorted(aborted) == sorted([("ada", running), ("ada", waiting)])
    ada.post("/api/rigs/bench-1/stop").raise_for_status()
    assert len([what for what, *_ in told(ada) if what == "aborted"]) == 2, "an idle stage aborts nothing"


def test_an_abort_is_stored_with_its_entry_or_not_at_all(service: Any, monkeypatch: Any) -> None:
    run = service.store.runs.create(unit="A", rig="bench-1", plan=QUICK, status="interrupted", provenance={})

    def killed(*_: Any) -> None:
        raise RuntimeError("killed")

    with monkeypatch.context() as patched:
        patched.setattr(trail, "append", killed)
        with pytest.raises(RuntimeError, match="killed"):
            service.abort(run.id, "ada")
    assert service.run(run.id).status == "interrupted"
    assert service.abort(run.id, "ada").status == "aborted"
    (entry,) = service.store.trail.entries(what=["aborted"])
    assert (entry.who, entry.run_id) == ("ada", run.id)


def test_the_log_names_them_too(ada: httpx.Client, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "calrig"):
        ada.post("/api/runs/0/pause")
        logged = lambda: [record.fields for record in caplog.records if hasattr(record, "fields")]  # noqa: E731
        (fields,) = wait_for(logged, "line in the log")  # it is written once the answer is on its way
    assert (fields["user"], fields["path"]) == ("ada", "/api/runs/0/pause")


def test_where_nobody_is_known_by_name_the_request_says_who(client: httpx.Client) -> None:
    named, unnamed = imported(client, "A", operator="eve"), imported(client, "A")
    assert (named["operator"], unnamed["operator"]) == ("eve", None)
    assert [who for _, who, _, _ in told(client)] == ["eve", None]


def test_each_amendment_is_told_with_who_and_why(ada: httpx.Client) -> None:
    run = imported(ada, "A")
    path = f"/api/runs/{run['id']}"
    for verb, body in [
        ("void", {"reason": "slipped"}),
        ("unvoid", {"reason": "it was another"}),
        ("note", {"note": "warm day"}),
        ("poses/1/exclude", {"reason": "bumped"}),
        ("poses/1/include", {}),
        ("unit", {"unit": "B", "reason": "misread"}),
    ]:
        assert ada.post(f"{path}/{verb}", json=body).status_code == 200
    assert "is in force: withdraw it first" in ada.delete("/api/units/A").json()["detail"]
    in_force = ada.get("/api/units/A").json()["revision_in_force"]
    body = {"reason": "no such unit"}
    assert ada.post(f"/api/units/A/calibrations/{in_force}/withdraw", json=body).status_code == 200
    assert ada.delete("/api/units/A").status_code == 204
    assert ada.get("/api/units/A").status_code == 404
    assert ada.delete("/api/units/B").status_code == 409
    whats = ["imported", "voided", "unvoided", "noted", "excluded", "included", "moved"]
    whats += ["withdrawn", "unit_removed"]
    assert [entry[:2] for entry in told(ada, unit="A")] == [(what, "ada") for what in whats]
    assert [entry[0] for entry in told(ada, unit="B")] == ["moved"]
    after = ada.get(path).json()
    assert (after["unit"], after["note"], after["voided"]) == ("B", "warm day", None)
    assert after["result"] == run["result"]
    assert ada.post(f"{path}/poses/1/include").status_code == 409, "a body is not needed"


def test_it_is_read_in_parts_and_in_both_orders(client: httpx.Client) -> None:
    runs = [imported(client, unit)["id"] for unit in ("A", "B", "A")]
    client.post(f"/api/runs/{runs[0]}/void", json={"reason": "slipped"}).raise_for_status()
    assert [entry[3] for entry in told(client, unit="A", what="imported")] == [runs[0], runs[2]]
    assert [entry[0] for entry in told(client, what=["voided", "noted"])] == ["voided"]
    entries = client.get("/api/trail", params={"newest_first": True, "limit": 2}).json()["entries"]
    last = entries[0]["seq"]
    assert [entry["seq"] for entry in entries] == [last, last - 1]
    assert [entry["what"] for entry in entries] == ["voided", "released"]
    assert told(client, since=entries[1]["at"]) == told(client, after=last - 2)
    assert [e[3] for e in told(client, newest_first=True, after=last)][-2:] == [runs[1], runs[0]]
    assert client.get("/api/trail", params={"what": "guessed"}).status_code == 422


@pytest.mark.skipif(ENGINE != "sqlite", reason="changes the file")
def test_a_trail_that_was_changed_says_where(client: httpx.Client, store_path: Path) -> None:
    for unit in ("A", "B", "C"):
        imported(client, unit, operator="ada")
    trail = client.get("/api/trail").json()
    assert (trail["intact"], trail["broken_at"]) == (True, None)
    with closing(sqlite3.connect(store_path)) as connection, connection:
        connection.execute("UPDATE trail SET who = 'eve' WHERE seq = 2")
    trail = client.get("/api/trail").json()
    assert (trail["intact"], trail["broken_at"]) == (False, 2)
