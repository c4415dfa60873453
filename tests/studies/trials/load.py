"""Twenty rigs at 200 Hz, a hundred clients of their events, thirty minutes: what is lost, what memory does.

The rigs run in real time, in processes of their own; the clients too.
"""

from __future__ import annotations

import asyncio
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from urllib.parse import urlsplit

import psutil

from calrig.settings import BoardSettings, RigSettings, StageSettings
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig

from .counting import Count, Extent, none_of
from .served import Served, configured

RIGS, CLIENTS, LENGTH_S = 20, 100, 1800.0
RIGS_A_PROCESS = 5
LOOK_S = 2.0
GROWTH_MB_A_HOUR = 20.0
"""Below this memory is called flat: in minutes, what a busy allocator keeps wanders by more."""
PLAN = {"elevations_deg": [-20, -10, 0, 10, 20], "sweeps": 1000, "settle_s": 0.5, "dwell_s": 2.0}
READINGS = 400


def _bench(connection: Connection, first: int, number: int) -> None:
    """Some rigs in this process, until the other end hangs up."""
    with ExitStack() as stack:
        rigs = [
            stack.enter_context(SimulatedRig(SimulatorSettings.from_options({"seed": first + k})))
            for k in range(number)
        ]
        connection.send([(rig.stage_port, rig.imu_port) for rig in rigs])
        connection.recv()


@contextmanager
def benches(number: int) -> Iterator[list[RigSettings]]:
    """So many rigs in processes of their own, as a service is told of them."""
    spawn, ports, ends = get_context("spawn"), [], []
    for first in range(0, number, RIGS_A_PROCESS):
        ours, theirs = spawn.Pipe()
        count = min(RIGS_A_PROCESS, number - first)
        process = spawn.Process(target=_bench, args=(theirs, first, count), daemon=True)
        process.start()
        ports += ours.recv()
        ends.append((ours, process))
    try:
        yield [
            RigSettings(
                name=f"bench-{k}",
                stage=StageSettings(driver="smc100", port=stage),
                imu=BoardSettings(driver="calrig", port=board),
            )
            for k, (stage, board) in enumerate(ports)
        ]
    finally:
        for ours, process in ends:
            ours.send(None)
            process.join()


@dataclass
class Heard:
    """What one client heard of one run."""

    run_id: str
    last: int = 0
    odd: int = 0
    """Events that did not follow the one before."""


async def _listen(host: str, port: int, heard: Heard) -> None:
    """Takes a run's events to their end; an event is written whole, so its lines are too."""
    reader, writer = await asyncio.open_connection(host, port)
    writer.write(f"GET /api/runs/{heard.run_id}/events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
    async for line in reader:
        if line.startswith(b"id: "):
            number = int(line[4:])
            heard.odd += number != heard.last + 1
            heard.last = number
        elif line == b"0\r\n":  # the last chunk
            break
    writer.close()


def watch(connection: Connection, host: str, port: int, run_ids: list[str], clients: int) -> None:
    """So many clients, in this process, until the last run has ended."""
    heard = [Heard(run_ids[k % len(run_ids)]) for k in range(clients)]

    async def listen() -> None:
        await asyncio.gather(*(_listen(host, port, one) for one in heard))

    asyncio.run(listen())
    connection.send(heard)


@dataclass
class _Memory:
    """Resident memory of a process over time."""

    at_s: list[float]
    mb: list[float]

    def growth_mb_a_hour(self) -> float:
        """From the mean of the middle third to that of the last."""
        third = len(self.mb) // 3
        middle, last = self.mb[third : 2 * third], self.mb[2 * third :]
        hours = (self.at_s[-1] - self.at_s[0]) / 3 / 3600
        return (sum(last) / len(last) - sum(middle) / len(middle)) / hours


def _watched(process: psutil.Process, length_s: float) -> _Memory:
    memory, began_s = _Memory([], []), time.monotonic()
    while (at_s := time.monotonic() - began_s) < length_s:
        memory.at_s.append(at_s)
        memory.mb.append(process.memory_info().rss / 1e6)
        threading.Event().wait(LOOK_S)
    return memory


def trial(extent: Extent) -> list[Count]:
    """All at once, for this share of thirty minutes.

    Of a share, what a busy machine does to rigs in real time is told and not judged: a board that got no
    processor for a second was silent, as far as anybody can know. What is lost without a word always is.
    """
    whole, length_s = extent.share >= 1.0, extent.share * LENGTH_S
    spawn = get_context("spawn")
    with tempfile.TemporaryDirectory() as name, benches(RIGS) as rigs:
        served = Served(configured(Path(name), rigs), Path(name) / "calrig.db")
        run_ids = [
            served.client.post("/api/runs", json={"unit": f"U{k}", "rig": rig.name, "plan": PLAN})
            .raise_for_status()
            .json()["id"]
            for k, rig in enumerate(rigs)
        ]
        ours, theirs = spawn.Pipe()
        url = urlsplit(str(served.client.base_url))
        arguments = (theirs, url.hostname, url.port, run_ids, CLIENTS)
        clients = spawn.Process(target=watch, args=arguments, daemon=True)
        clients.start()
        process = psutil.Process(served.process.pid)
        before_s = sum(process.cpu_times()[:2])
        memory = _watched(process, length_s)
        cpu_s = sum(process.cpu_times()[:2]) - before_s
        for run_id in run_ids:
            served.client.post(f"/api/runs/{run_id}/abort")  # 409 where it failed before: told below
        all_heard: list[Heard] = ours.recv()
        clients.join()
        runs = {run_id: served.get(f"/api/runs/{run_id}") for run_id in run_ids}
        poses = {run_id: served.get(f"/api/runs/{run_id}/poses") for run_id in run_ids}
        last = {run_id: max(one.last for one in all_heard if one.run_id == run_id) for run_id in run_ids}
        ended_s = served.terminate()
    measured = sum(len(of_run) for of_run in poses.values())
    faults = [f"run {run_id}: {run['faults']}" for run_id, run in runs.items() if run["faults"]]
    short = [
        f"run {run_id}, pose {pose['index']}: {pose['n_samples']}"
        for run_id, of_run in poses.items()
        for pose in of_run
        if pose["n_samples"] < READINGS - 1 and (whole or not runs[run_id]["faults"])
    ]
    failed = [f"run {i}: {run['error']}" for i, run in runs.items() if run["status"] != "aborted"]
    missed = [
        f"run {one.run_id}: {one.odd} out of order, the last is {one.last} of {last[one.run_id]}"
        for one in all_heard
        if one.odd or one.last != last[one.run_id]
    ]
    growth = memory.growth_mb_a_hour()
    tried = f"{RIGS} rigs, {length_s / 60:g} min, {measured} poses"
    events = f"{CLIENTS} clients, {sum(one.last for one in all_heard)} events"
    return [
        none_of("runs that failed", tried, failed),
        none_of("poses with a lost sample", tried, short),
        Count(
            "runs with a fault counted",
            tried,
            "0" if whole else "told only",
            str(len(faults)),
            not (whole and faults),
            tuple(faults),
        ),
        none_of("clients that missed an event or had it out of order", events, missed),
        Count(
            "memory's growth, MB an hour",
            f"{memory.mb[0]:.0f} MB at first, {memory.mb[-1]:.0f} at last",
            f"< {GROWTH_MB_A_HOUR:g}" if whole else "told only",
            f"{growth:.0f}",
            growth < GROWTH_MB_A_HOUR or not whole,
        ),
        Count("of one core", tried, "told only", f"{100 * cpu_s / length_s:.0f} %", kept=True),
        Count(
            "SIGTERM to end, s",
            "once",
            "< 5" if whole else "told only",
            f"{ended_s:.1f}",
            ended_s < 5.0 or not whole,
        ),
    ]
