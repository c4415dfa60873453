"""Stop, abort and health have a path of their own: they are answered while every thread is taken."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import httpx
import pytest
from support import LONG, NO_TLS, running_service, serving, wait_for

from calrig.instruments.ports import open_port
from calrig.settings import RigSettings
from calrig.store.runs import Runs

THREADS = 40
"""Those that all requests of the application share."""


@contextmanager
def no_thread_free(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """As many requests as there are threads wait, and some more for a thread, until what is given is set."""
    taken, release = threading.Semaphore(0), threading.Event()

    def never_ending(*_: object, **__: object) -> tuple[list[object], None]:
        taken.release()
        release.wait(60)
        return [], None

    monkeypatch.setattr(Runs, "search", never_ending)
    with ThreadPoolExecutor(THREADS + 5) as others:
        for _ in range(THREADS + 5):
            others.submit(httpx.get, f"{client.base_url}/api/runs", timeout=60, verify=NO_TLS)
        for _ in range(THREADS):
            assert taken.acquire(timeout=60)
        try:
            yield release
        finally:
            release.set()


@pytest.fixture
def _no_thread_is_free(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Until the test has ended."""
    with no_thread_free(client, monkeypatch):
        yield


@pytest.fixture
def run_id(client: httpx.Client) -> str:
    """A run that moves."""
    run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
    wait_for(
        lambda: client.get(f"/api/runs/{run['id']}").json()["progress"]["poses_done"] or None, "first pose"
    )
    return str(run["id"])


@pytest.mark.usefixtures("run_id", "_no_thread_is_free")
def test_a_stop_with_a_live_run_is_answered_while_every_thread_is_taken(client: httpx.Client) -> None:
    assert client.post("/api/rigs/bench-1/stop").status_code == 200
    wait_for(lambda: client.post("/api/rigs/bench-1/stop").json()["state"] == "idle", "an idle rig")
    assert client.get("/api/health").status_code == 200


@pytest.mark.usefixtures("_no_thread_is_free")
def test_refusals_of_a_stop_need_no_thread_either(client: httpx.Client) -> None:
    assert client.post("/api/rigs/none/stop").status_code == 404
    assert client.post("/api/runs/none/abort").status_code == 404


def test_an_abort_with_a_live_run_is_answered_while_every_thread_is_taken(
    client: httpx.Client, run_id: str, _no_thread_is_free: None
) -> None:
    aborted = client.post(f"/api/runs/{run_id}/abort").raise_for_status().json()
    assert aborted["status"] == "aborted"
    again = client.post(f"/api/runs/{run_id}/abort")
    assert (again.status_code, again.json()["detail"]) == (
        409,
        f"run {run_id} is aborted and cannot be aborted",
    )


def test_the_service_ends_its_runs_though_every_thread_is_taken_and_its_requests_end_later(
    rig: RigSettings, store_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running_service(store_path, rig) as service, ExitStack() as stack:
        with serving(service) as client:
            run = client.post("/api/runs", json={"unit": "A", "plan": LONG}).raise_for_status().json()
            release = stack.enter_context(no_thread_free(client, monkeypatch))
            ended: list[str] = []

            def watch() -> None:
                ended.append(service.wait(run["id"], None).status)
                release.set()  # without which the server cannot end

            watcher = threading.Thread(target=watch, daemon=True)
            watcher.start()
        watcher.join(60)
    assert ended == ["interrupted"]


def test_a_stop_of_a_stage_that_another_program_has_is_409_with_what_to_do(
    client: httpx.Client, rig: RigSettings
) -> None:
    with (
        closing(open_port(rig.stage.port, baudrate=57600, timeout_s=0.1)) as port,
        port.clock.standing_aside(),  # whoever has a simulated port open holds its time up else
    ):
        answer = client.post("/api/rigs/bench-1/stop")
    assert answer.status_code == 409
    assert "in use by another program" in answer.json()["detail"]
    assert answer.json()["detail"].endswith(": cut its motor power")
