"""What tests share beside fixtures: a fast rig's options, quick plans, the service and the server."""

from __future__ import annotations

import asyncio
import json
import os
import random
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from socketserver import BaseServer
from typing import Any, TypeVar

import httpx
import pytest
import sqlalchemy
from postgresql_server import store_at
from repository import SHARED
from shared_processes import shared_processes
from virtual_time.clock import VirtualClock

from calrig.settings import BoardSettings, ClampSettings, ReferenceSettings, RigSettings, StageSettings
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig

DATA = Path(os.environ.get("CALRIG_DATA", SHARED / "data"))
"""The measured logs; tests that need them skip, saying so, where they are not."""

FAST: dict[str, Any] = {
    "seed": 1,
    "time_scale": 20.0,
    "stage": {"velocity_dps": 60.0, "acceleration_dps2": 240.0, "homing_velocity_dps": 30.0},
    "mount": {"offset_deg": 0.8},
    "imu": {"gyro_bias_dps": [1.4, -0.6, 0.3]},
}
"""A simulated rig that is twenty times faster than life, with a known mount offset and gyro bias."""

QUICK: dict[str, Any] = {"elevations_deg": [-40, 0, 40], "sweeps": 2, "settle_s": 0.5, "dwell_s": 1.0}
"""A plan of six poses, done in about a second on a fast rig."""

PATIENCE_S = 120.0
"""What nothing waits for longer than: a busy machine is no failure, and pytest ends what hangs."""

LONG: dict[str, Any] = {**QUICK, "sweeps": 300}
"""A plan that no test waits for the end of."""

NO_TLS = False
"""`verify` of clients of a test's own server: to read all authorities' certificates takes each 20 ms else."""

T = TypeVar("T")
Server = TypeVar("Server", bound=BaseServer)


def fast(options: dict[str, Any]) -> SimulatorSettings:
    """The simulator's options over those of `FAST`."""
    merged: dict[str, Any] = dict(FAST)
    for key, value in options.items():
        merged[key] = {**merged.get(key, {}), **value} if isinstance(value, dict) else value
    return SimulatorSettings.from_options(merged)


def known_as(name: str, rig: SimulatedRig) -> RigSettings:
    """The settings that a service knows a simulated rig by."""
    return RigSettings(
        name=name,
        stage=StageSettings(driver=rig.stage_driver, port=rig.stage_port),
        imu=BoardSettings(driver=rig.imu_driver, port=rig.imu_port),
        clamp=ClampSettings(driver="index", port=rig.clamp_port) if rig.clamp_port else None,
        reference=ReferenceSettings(std_deg=0.29),
    )


def run_async(work: Coroutine[Any, Any, T]) -> T:
    """What comes of it, in a loop and a thread of its own: Playwright keeps a loop going in the tests'."""
    with ThreadPoolExecutor(1) as beside:
        return beside.submit(asyncio.run, work).result()


def wait_for(look: Callable[[], T | None], what: str, deadline_s: float = PATIENCE_S) -> T:
    """Looks again and again until there is something; fails, saying what was awaited, at the deadline."""
    give_up_s = time.monotonic() + deadline_s
    while time.monotonic() < give_up_s:
        if found := look():
            return found
        threading.Event().wait(0.01)
    raise AssertionError(f"no {what} within {deadline_s:g} s")


def ended(client: httpx.Client, run_id: str, deadline_s: float = PATIENCE_S) -> dict[str, Any]:
    """The run once it has ended, which its event stream tells by its own end."""
    with client.stream("GET", f"/api/runs/{run_id}/events", timeout=deadline_s) as events:
        for _ in events.raise_for_status().iter_raw():
            pass
    return client.get(f"/api/runs/{run_id}").raise_for_status().json()


_COMMITTED = [0]
LOOK_S = 0.1
"""How long a look at a store is put off at most where nothing was committed."""


@sqlalchemy.event.listens_for(sqlalchemy.Engine, "commit")
def _committed(_connection: sqlalchemy.Connection) -> None:
    _COMMITTED[0] += 1


def after_commits(look: Callable[[], T], clock: VirtualClock) -> Callable[[], T | None]:
    """Return a look at a store for `VirtualClock.until`: there are too many instants for queries."""
    seen, looked_s = -1, 0.0

    def looks() -> T | None:
        nonlocal seen, looked_s
        if _COMMITTED[0] == seen and clock.now_s() < looked_s + LOOK_S:
            return None
        seen, looked_s = _COMMITTED[0], clock.now_s()
        return look()

    return looks


def one_now(values: Iterable[T]) -> list[Any]:
    """The first of several draws or cases of one kind, and the others among the statistical tests."""
    first, *others = values
    return [first, *(pytest.param(one, marks=pytest.mark.statistical) for one in others)]


POSES = "target_deg,reading_deg\n-40,-39.1\n-10,-9.3\n10,10.9\n40,40.8\n"
"""Four poses of somebody's own, as a file to import."""


def imported(
    client: httpx.Client, unit: str, poses: str = POSES, name: str = "poses.csv", **form: str
) -> dict[str, Any]:
    """A completed run of a unit, made of a file: for tests that are not about how it was measured."""
    file = {"file": (name, poses)}
    return client.post("/api/imports", files=file, data={"unit": unit, **form}).raise_for_status().json()


def declared(client: httpx.Client, path: str, kind: str, n_bytes: int) -> tuple[int, str]:
    """Status and detail of the answer to a body that is said to have n_bytes and of which none is sent."""
    with closing(
        HTTPConnection(client.base_url.host, client.base_url.port, timeout=PATIENCE_S)
    ) as connection:
        connection.putrequest("POST", path)
        connection.putheader("Content-Type", kind)
        connection.putheader("Content-Length", str(n_bytes))
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())["detail"]


def lasting_port() -> int:
    """A free port for a program that starts later, or twice: who asks for any port is not given this one."""
    of_any = Path("/proc/sys/net/ipv4/ip_local_port_range")
    below = int(of_any.read_text().split()[0]) if of_any.exists() else 32_768
    for port in random.sample(range(below // 2, below), 100):
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
    raise AssertionError("no port is free")


@contextmanager
def program(*command: object, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A process whose output is read as text; it ends here, whatever came of the test."""
    words = [str(word) for word in command]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, **options) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def at_work(server: Server) -> Iterator[Server]:
    """Somebody else's server, in a thread; it ends here, whatever came of the test."""
    with server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join(PATIENCE_S)


@contextmanager
def running_service(store_path: Path, *rigs: RigSettings) -> Iterator[Any]:
    """A run service over the store at the path."""
    from calrig.runs.service import RunService
    from calrig.store import Store

    with (
        Store.open(store_at(store_path), writer="tests") as store,
        closing(RunService(store, rigs)) as service,
    ):
        yield service


@contextmanager
def serving(service: Any, *, own_processes: bool = False, **options: Any) -> Iterator[httpx.Client]:
    """The real application on a free port, served by uvicorn in a thread; a client of it.

    Args:
        service: carries out what is asked.
        own_processes: whether it has processes for heavy work that end with it, not those of all services.
        **options: those of `create_app`.
    """
    from calrig.api.app import create_app
    from calrig.api.server import Server, listen

    ready = threading.Event()
    listener = listen("127.0.0.1", 0)
    url = f"http://127.0.0.1:{listener.getsockname()[1]}"
    app = create_app(service, **options)
    if not own_processes:
        app.state.context = replace(app.state.context, processes=shared_processes())
    server = Server(app, ready.set)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="server", daemon=True)
    thread.start()
    try:
        assert ready.wait(PATIENCE_S), "the server did not start"
        with httpx.Client(base_url=url, timeout=PATIENCE_S, verify=NO_TLS) as client:
            yield client
    finally:
        server.should_exit = True
        thread.join(PATIENCE_S)
        assert not thread.is_alive(), "the server did not stop"
