"""The event stream: complete, in order, resumed where it was left, and ended by the run or the service."""

from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support import FAST, LONG, QUICK, ended, running_service, serving, wait_for

from calrig.api import events as api_events
from calrig.store import StoreUnavailableError


def events(lines: Iterator[str]) -> Iterator[tuple[int, str, dict]]:
    """The events of a stream as (id, type, data), told apart from comments (HTML standard, 9.2.6)."""
    fields: dict[str, str] = {}
    for line in lines:
        if line and not line.startswith(":"):
            name, _, value = line.partition(": ")
            fields[name] = value
        elif not line and fields:
            yield int(fields["id"]), fields["event"], json.loads(fields["data"])
            fields = {}


def read(client: httpx.Client, run_id: str, after: int | None = None, limit: int | None = None) -> list:
    headers = {} if after is None else {"Last-Event-ID": str(after)}
    with client.stream("GET", f"/api/runs/{run_id}/events", headers=headers) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        return list(itertools.islice(events(answer.iter_lines()), limit))


def start(client: httpx.Client, plan: dict = QUICK) -> str:
    return client.post("/api/runs", json={"unit": "AS-1", "plan": plan}).json()["id"]


@pytest.fixture(scope="module")
def finished(rig, tmp_path_factory):
    """A client, a finished run's id and its whole event log, read while it went on."""
    path = tmp_path_factory.mktemp("events") / "calrig.db"
    with running_service(path, rig) as service, serving(service) as client:
        run_id = start(client)
        log = read(client, run_id)
        yield client, run_id, log


def test_a_run_followed_from_its_start_tells_everything_and_ends(finished):
    client, run_id, log = finished
    assert [seq for seq, _, _ in log] == list(range(1, len(log) + 1))
    states = [data["status"] for _, kind, data in log if kind == "state"]
    assert states == ["queued", "running", "completed"]
    assert log[-1][1] == "state"
    poses = client.get(f"/api/runs/{run_id}/poses").json()
    told = [data for _, kind, data in log if kind == "pose"]
    known_later = {"excluded", "residual_deg"}
    assert told == [{k: v for k, v in pose.items() if k not in known_later} for pose in poses]
    progress = [data for _, kind, data in log if kind == "progress"]
    assert (
        progress[-1] == client.get(f"/api/runs/{run_id}").json()["progress"] or progress[-1]["fraction"] == 1
    )


def test_readings_are_thinned_to_twenty_a_second(finished):
    _, _, log = finished
    readings = [data for _, kind, data in log if kind == "reading"]
    lasted_s = (readings[-1]["time_s"] - readings[0]["time_s"]) / FAST["time_scale"]
    assert 10 < len(readings) <= 20 * lasted_s + 2
    assert set(readings[0]) == {"time_s", "stage_deg", "reading_deg", "temperature_c"}
    assert readings == sorted(readings, key=lambda data: data["time_s"])


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_what_follows_any_event_is_the_rest_without_gap_or_repetition(finished, data):
    client, run_id, log = finished
    after = data.draw(st.integers(0, len(log) + 3))
    assert read(client, run_id, after) == log[after:]


def test_a_stream_cut_and_resumed_while_the_run_goes_on_misses_nothing(client):
    run_id = start(client)
    seen: list = []
    while not seen or seen[-1][1:] != ("state", {"status": "completed", "error": None}):
        seen += read(client, run_id, seen[-1][0] if seen else None, limit=3)
    assert seen == read(client, run_id)


def test_many_watchers_of_one_run_all_see_the_same_and_are_woken_by_one_call(service, client, monkeypatch):
    subscribed: list = []
    subscribe = service.bus.subscribe
    monkeypatch.setattr(service.bus, "subscribe", lambda *of: subscribed.append(of) or subscribe(*of))
    run_id = start(client)
    with ThreadPoolExecutor(5) as watchers:
        logs = list(watchers.map(lambda _: read(client, run_id), range(5)))
    assert all(log == logs[0] for log in logs)
    assert len(subscribed) < 5


@pytest.mark.parametrize("header", ["abc", "-1", "1.5", "9" * 30])
def test_a_last_event_id_that_is_none_is_422(finished, header):
    client, run_id, _ = finished
    answer = client.get(f"/api/runs/{run_id}/events", headers={"Last-Event-ID": header})
    assert answer.status_code == 422
    assert "Last-Event-ID" in answer.json()["detail"]


def test_a_client_that_goes_away_leaves_nothing_behind_and_the_run_alone(service, monkeypatch):
    watching: list = []
    subscribe = service.bus.subscribe

    def counted(run_id, wake):
        leave = subscribe(run_id, wake)
        watching.append(wake)
        return lambda: (watching.remove(wake), leave())

    monkeypatch.setattr(service.bus, "subscribe", counted)
    with serving(service) as client:
        run_id = start(client, LONG)
        with client.stream("GET", f"/api/runs/{run_id}/events") as answer:
            told = events(answer.iter_lines())
            next(told)
            assert len(watching) == 1
        wait_for(lambda: not watching, "end of the subscription")
        url = f"/api/runs/{run_id}"
        wait_for(lambda: client.get(url).json()["progress"]["poses_done"] > 0, "pose without a watcher")
        client.post(f"/api/runs/{run_id}/abort")
        assert ended(client, run_id)["status"] == "aborted"


def test_a_service_that_stops_ends_its_streams(service):
    log: list = []
    with serving(service) as client:
        run_id = start(client, LONG)
        first = threading.Event()

        def watch() -> None:
            url = client.base_url.join(f"/api/runs/{run_id}/events")
            with httpx.stream("GET", url, timeout=60) as answer:
                for event in events(answer.iter_lines()):
                    log.append(event)
                    first.set()

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        assert first.wait(60)
    watcher.join(60)
    assert not watcher.is_alive()
    assert service.run(run_id).status == "interrupted"


def test_a_stream_tells_the_end_of_a_run_that_the_store_was_told_of_late(client, service, monkeypatch):
    looks: list[str] = []
    has_room = threading.Event()
    look, update = api_events._look, service.store.runs.update

    def counted(context, run_id, known):
        looks.append(service.run(run_id).status)
        return look(context, run_id, known)

    def refused(run_id, **changes):
        if changes.get("status") == "completed" and not has_room.is_set():
            raise StoreUnavailableError("the disk is full: free some space")
        return update(run_id, **changes)

    monkeypatch.setattr("calrig.api.events._look", counted)
    monkeypatch.setattr("calrig.api.events.KEEP_ALIVE_S", 0.005)
    monkeypatch.setattr(service.store.runs, "update", refused)
    run_id = start(client)
    with client.stream("GET", f"/api/runs/{run_id}/events") as answer:
        wait_for(lambda: "completed" in looks, "look at the log of a run that is over, as far as is known")
        has_room.set()
        assert list(events(answer.iter_lines()))[-1][1:] == ("state", {"status": "completed", "error": None})


def test_a_stream_with_nothing_to_tell_says_so_now_and_then(client, monkeypatch):
    monkeypatch.setattr("calrig.api.events.KEEP_ALIVE_S", 0.005)  # ten times as often as a reading comes
    run_id = start(client, LONG)
    client.post(f"/api/runs/{run_id}/pause")
    wait_for(lambda: client.get(f"/api/runs/{run_id}").json()["status"] == "paused", "pause")
    known = read(client, run_id, limit=1)[-1][0]
    with client.stream("GET", f"/api/runs/{run_id}/events", headers={"Last-Event-ID": str(known)}) as answer:
        assert any(line.startswith(":") for line in answer.iter_lines())
    client.post(f"/api/runs/{run_id}/abort")
