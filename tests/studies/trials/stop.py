"""The red button while the service has much to do: how long stops take, and how much memory.

Every load has a service of its own, on rigs in other processes, and clients in another one.
"""

from __future__ import annotations

import http.client
import math
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psutil

from calrig.settings import BoardSettings, RigSettings, StageSettings

from . import stop_loads
from .counting import Count, Extent
from .load import PLAN, benches
from .served import Served, configured, until
from .stop_loads import Client, Target, loaded, mute_terminal

STOPS = 200
OF_RUNS = 20
"""One stop in so many, and one at least, is of a stage with a run on it, the others of one without."""
UNLOADED = 9
P99_S = 0.25
MOST_MB = 300.0
GIVE_UP_S = 5.0
"""How long a stop is waited for; after two that took so long the rest of them is not tried."""
MOST_LATE = 1
WARM_UP_S = 1.0
EVERY_S = 0.1
"""From one stop's end to the next one: they meet the load in all its phases."""
LOOK_S = 0.1
TOKEN = "the-benches-of-building-4"

LOADS: tuple[tuple[str, Client, int], ...] = (
    ("60 diagnoses", stop_loads.diagnosis, 60),
    ("10 imports of 100,000 poses", stop_loads.large_import, 10),
    ("450 slow strangers, 12 of them guessing tokens", stop_loads.guesser, 450),
    ("40 scans", stop_loads.scan, 40),
    ("60 stops of a mute neighbour", stop_loads.neighbour, 60),
    ("400 event clients", stop_loads.listener, 400),
    ("a full disk, and 10 imports", stop_loads.large_import, 10),
)
FULL = "a full disk"


@dataclass
class Stops:
    """What a row of stops came to; times in seconds, those of runs apart.

    `processor_s` is what the service has computed meanwhile, whatever for: but for other programs, it could
    not have answered later by more than that.
    """

    idle_s: list[float] = field(default_factory=list)
    running_s: list[float] = field(default_factory=list)
    processor_s: list[float] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    late: int = 0

    def beyond_s(self, unloaded: Stops) -> list[float]:
        """By how much each took longer than the device's own answer, sorted."""
        pairs = ((self.idle_s, unloaded.idle_s), (self.running_s, unloaded.running_s))
        return sorted(took_s - statistics.median(own) for times, own in pairs for took_s in times)


class _Memory(threading.Thread):
    """The most that a process and its children took, in MB."""

    def __init__(self, process: psutil.Process) -> None:
        super().__init__(daemon=True)
        self.most_mb = self.children_mb = 0.0
        self._process = process
        self._ended = threading.Event()

    def run(self) -> None:
        while not self._ended.wait(LOOK_S):
            self.most_mb = max(self.most_mb, _mb(self._process))
            self.children_mb = max(self.children_mb, sum(map(_mb, self._process.children(recursive=True))))

    def end(self) -> None:
        self._ended.set()
        self.join()


def _mb(process: psutil.Process) -> float:
    try:
        return float(process.memory_info().rss) / 1e6
    except psutil.NoSuchProcess:
        return 0.0


def _computed_s(pid: int) -> float:
    """Processor time of a process's threads, to the nanosecond (Linux, proc_pid_schedstat)."""
    total_ns = 0
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # it has ended
            total_ns += int((thread / "schedstat").read_text("ascii").split()[0])
    return total_ns / 1e9


class _Bench:
    """A service on a rig that is idle, one with a run begun anew once stopped, one whose run goes on."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self._url = urlsplit(str(served.client.base_url))
        self._watched_id = self._begin("bench-2") or ""
        self.run_id = self._begin("bench-1") or ""

    def target(self, imported: tuple[str, ...]) -> Target:
        assert self._url.hostname is not None and self._url.port is not None
        return Target(self._url.hostname, self._url.port, TOKEN, imported, self._watched_id)

    def stop(self, rig: str, stops: Stops, times: list[float]) -> None:
        """One stop by a connection of its own."""
        began_s, computed_s = time.monotonic(), _computed_s(self.served.process.pid)
        connection = http.client.HTTPConnection(self._url.netloc, timeout=GIVE_UP_S)
        try:
            connection.request("POST", f"/api/rigs/{rig}/stop", headers={"Authorization": f"Bearer {TOKEN}"})
            answer = connection.getresponse()
            status, said = answer.status, answer.read()
        except (OSError, http.client.HTTPException) as error:
            stops.late += isinstance(error, TimeoutError)
            stops.refused.append(f"{type(error).__name__} after {time.monotonic() - began_s:.1f} s")
            return
        finally:
            connection.close()
        times.append(time.monotonic() - began_s)
        stops.processor_s.append(_computed_s(self.served.process.pid) - computed_s)
        if status != 200:
            stops.refused.append(f"{status}: {said[:200]!r}")

    def stops(self, number: int, *, one_run_in: int = OF_RUNS) -> Stops:
        """So many stops, one after the other; fewer where one after the other is not answered."""
        stops, one_run_in = Stops(), min(one_run_in, number)
        for k in range(number):
            threading.Event().wait(EVERY_S)
            if stops.late > MOST_LATE:
                stops.refused += [f"{number - k} more were not tried"]
                break
            if k % one_run_in == one_run_in - 1 and self._is_running():
                self.stop("bench-1", stops, stops.running_s)
                self.run_id = self._begin("bench-1") or self.run_id
            else:
                self.stop("bench-0", stops, stops.idle_s)
        return stops

    def _begin(self, rig: str) -> str | None:
        """A run; None where it is refused, as on a full disk."""

        def begin() -> str | None:
            body = {"unit": "U1", "rig": rig, "plan": PLAN}
            answer = self.served.client.post("/api/runs", json=body)
            return str(answer.json()["id"]) if answer.status_code == 201 else None

        try:
            run_id = until(begin, 5.0)
            until(lambda: self._is_running(run_id) or None, 10.0)
        except httpx.HTTPError:
            return None
        return run_id

    def _is_running(self, run_id: str | None = None) -> bool:
        try:
            answer = self.served.client.get(f"/api/runs/{run_id or self.run_id}")
        except httpx.HTTPError:
            return False
        return answer.status_code == 200 and answer.json()["status"] == "running"


@contextmanager
def _served(rigs: list[RigSettings]) -> Iterator[_Bench]:
    with tempfile.TemporaryDirectory() as name, mute_terminal() as port:
        mute = RigSettings(
            name="mute",
            stage=StageSettings(driver="grbl", port=port),
            imu=BoardSettings(driver="calrig", port=port),
        )
        served = Served(configured(Path(name), [*rigs, mute]), Path(name) / "calrig.db", token=TOKEN)
        try:
            yield _Bench(served)
        finally:
            served.client.close()
            served.kill()


def _imported(served: Served) -> tuple[str, ...]:
    ids = []
    for k in range(5):
        file = {"file": ("poses.csv", stop_loads.poses(100, seed=k))}
        answer = served.client.post(
            "/api/imports", files=file, data={"unit": f"SMALL-{k}"}
        ).raise_for_status()
        ids.append(str(answer.json()["id"]))
    return tuple(ids)


def _fill_disk(process: psutil.Process) -> None:
    """No file of the process grows any more, whoever it runs as: each write fails as on a full disk."""
    process.rlimit(psutil.RLIMIT_FSIZE, (1, 1))


def _row(what: str, client: Client, crowd: int, rigs: list[RigSettings], extent: Extent) -> Count:
    with _served(rigs) as bench:
        process = psutil.Process(bench.served.process.pid)
        imported = _imported(bench.served)
        unloaded = bench.stops(UNLOADED, one_run_in=UNLOADED // 3)
        if what.startswith(FULL):
            _fill_disk(process)
        memory = _Memory(process)
        memory.start()
        with loaded(client, crowd, bench.target(imported)) as end:
            threading.Event().wait(WARM_UP_S)
            stops = bench.stops(extent.of(STOPS))
            heard = end()
        memory.end()
    return _count(what, unloaded, stops, memory, heard, whole=extent.share >= 1.0)


def _count(
    what: str, unloaded: Stops, stops: Stops, memory: _Memory, heard: dict[str, int], *, whole: bool
) -> Count:
    """A row. Ten stops have no 99th percentile: of a share the answers are judged, and the time is told."""
    beyond_s = stops.beyond_s(unloaded)
    p99_s, processor_s = _p99(beyond_s), _p99(sorted(stops.processor_s))
    answers = ", ".join(f"{count} {status}" for status, count in sorted(heard.items()))
    own = f"{statistics.median(unloaded.idle_s):.3f} s" if unloaded.idle_s else "none"
    tried = f"{len(stops.idle_s)} idle, {len(stops.running_s)} running; alone {own}"
    return Count(
        f"stop, beside {what}",
        tried + (f"; load: {answers}" if answers else ""),
        f"p99 ≤ {P99_S:g} s, 0 refused, ≤ {MOST_MB:g} MB",
        f"p99 {p99_s:.3f} s, longest {max(beyond_s, default=math.inf):.3f} s; p99 of what the service "
        f"computed meanwhile {processor_s:.3f} s; {len(stops.refused)} refused, "
        f"{memory.most_mb:.0f} MB, children {memory.children_mb:.0f} MB",
        (not whole or p99_s <= P99_S)
        and not (stops.refused or unloaded.refused)
        and memory.most_mb <= MOST_MB,
        tuple([f"alone: {line}" for line in unloaded.refused] + stops.refused[:5]),
    )


def _p99(sorted_s: list[float]) -> float:
    return sorted_s[math.ceil(0.99 * len(sorted_s)) - 1] if sorted_s else math.inf


def trial(extent: Extent) -> list[Count]:
    """This share of 200 stops beside each load."""
    with benches(3) as rigs:
        return [_row(what, client, crowd, rigs, extent) for what, client, crowd in LOADS]
