"""Forty rigs on eight benches, two hundred watchers at two processes of a centre: what is lost or late.

The rigs run in real time, in processes of their own; benches, the centre's processes and watchers too.
"""

from __future__ import annotations

import itertools
import statistics
import tempfile
import threading
import time
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import psutil

from .centre import Centre, centre
from .counting import Count, Extent, none_of
from .load import Heard, benches, watch
from .served import until

RIGS, BENCHES, WATCHERS, PROCESSES = 40, 8, 200, 2
LENGTH_S = 600.0
ALONE_S = 40.0
SLOWER = 1.3
STOP_S = 1.0
PLAN = {"elevations_deg": [-20, -10, 0, 10, 20], "sweeps": 1000, "settle_s": 0.5, "dwell_s": 2.0}
READINGS = 400
DELIVERED_S = 60.0


def _begun(at: Centre, rigs: list[str]) -> dict[str, str]:
    """Runs begun in turn at the centre's processes, by rig."""
    run_ids = {}
    for k, rig in enumerate(rigs):
        body = {"unit": f"U{k}", "rig": rig, "plan": PLAN}
        answer = at.served[k % PROCESSES].client.post("/api/runs", json=body)
        run_ids[rig] = answer.raise_for_status().json()["id"]
    return run_ids


def _pose_s(poses: list[dict[str, Any]]) -> float:
    """From one pose to the next, by the board's clock."""
    times_s = [pose["time_s"] for pose in poses]
    return statistics.median(b - a for a, b in itertools.pairwise(times_s))


def _alone(at: Centre, rig: str) -> float:
    """Seconds a pose on one rig while the others stand."""
    (run_id,) = _begun(at, [rig]).values()
    threading.Event().wait(ALONE_S)
    at.served[0].client.post(f"/api/runs/{run_id}/abort").raise_for_status()
    return _pose_s(_delivered(at, run_id))


def _delivered(at: Centre, run_id: str) -> list[dict[str, Any]]:
    """The poses of a run that has ended, once all of them have come."""

    def look() -> list[dict[str, Any]] | None:
        run = at.served[0].get(f"/api/runs/{run_id}")
        poses = at.served[0].get(f"/api/runs/{run_id}/poses")
        return poses if run["finished_at"] and len(poses) == run["progress"]["poses_done"] else None

    return until(look, DELIVERED_S) or []


def _watchers(at: Centre, run_ids: list[str]) -> Any:
    """Starts the watchers, half of them at each process; gives what they heard once all runs have ended."""
    spawn, ends = get_context("spawn"), []
    for served in at.served:
        ours, theirs = spawn.Pipe()
        url = urlsplit(str(served.client.base_url))
        arguments = (theirs, url.hostname, url.port, run_ids, WATCHERS // PROCESSES)
        spawn.Process(target=watch, args=arguments, daemon=True).start()
        ends.append(ours)
    return lambda: [heard for end in ends for heard in end.recv()]


def _stopped(at: Centre, rigs: list[str]) -> list[float]:
    """Stops each rig from the centre; seconds to the answer, which comes once the stage stands."""
    took_s = []
    for k, rig in enumerate(rigs):
        began_s = time.monotonic()
        answer = at.served[k % PROCESSES].client.post(f"/api/rigs/{rig}/stop")
        took_s.append(time.monotonic() - began_s if answer.is_success else float("inf"))
    return took_s


def trial(extent: Extent) -> list[Count]:
    """All at once, for this share of ten minutes."""
    length_s = extent.share * LENGTH_S
    with tempfile.TemporaryDirectory() as name, benches(RIGS) as rigs, centre(Path(name), PROCESSES) as at:
        each = RIGS // BENCHES
        for k in range(BENCHES):
            at.join(f"hall-{k}", rigs[k * each : (k + 1) * each])
        names = [rig.name for rig in rigs]
        until(lambda: len(at.served[0].get("/api/rigs")) == RIGS or None, DELIVERED_S)
        alone_s = _alone(at, names[0])
        run_ids = _begun(at, names)
        heard_by_all = _watchers(at, list(run_ids.values()))
        psutil.cpu_percent()
        threading.Event().wait(length_s)
        busy = psutil.cpu_percent()
        took_s = _stopped(at, names)
        all_heard: list[Heard] = heard_by_all()
        poses = {run_id: _delivered(at, run_id) for run_id in run_ids.values()}
        runs = {run_id: at.served[0].get(f"/api/runs/{run_id}") for run_id in run_ids.values()}
    return _counts(length_s, busy, alone_s, took_s, all_heard, poses, runs)


def _counts(
    length_s: float,
    busy: float,
    alone_s: float,
    took_s: list[float],
    all_heard: list[Heard],
    poses: dict[str, list[dict[str, Any]]],
    runs: dict[str, dict[str, Any]],
) -> list[Count]:
    measured = sum(len(of_run) for of_run in poses.values())
    tried = f"{RIGS} rigs, {BENCHES} benches, {length_s / 60:g} min, {measured} poses"
    short = [
        f"run {run_id}, pose {pose['index']}: {pose['n_samples']}"
        for run_id, of_run in poses.items()
        for pose in of_run
        if pose["n_samples"] < READINGS - 1
    ]
    last = {run_id: max(one.last for one in all_heard if one.run_id == run_id) for run_id in runs}
    missed = [
        f"run {one.run_id}: {one.odd} out of order, the last is {one.last} of {last[one.run_id]}"
        for one in all_heard
        if one.odd or one.last != last[one.run_id]
    ]
    failed = [f"run {i}: {run['error']}" for i, run in runs.items() if run["status"] != "aborted"]
    slower = statistics.median(_pose_s(of_run) for of_run in poses.values() if len(of_run) > 2) / alone_s
    slowest_s = max(took_s)
    return [
        none_of("runs that failed", tried, failed),
        none_of("poses with a lost sample", tried, short),
        none_of(
            "watchers that missed an event or had it out of order",
            f"{len(all_heard)} watchers, {sum(one.last for one in all_heard)} events",
            missed,
        ),
        Count(
            "time of a pose against one rig alone",
            f"{alone_s:.2f} s alone",
            f"≤ {SLOWER:g}",
            f"{slower:.2f}",
            slower <= SLOWER,
        ),
        Count(
            "stop at the centre, s to the answer: median, longest",
            f"{len(took_s)} stops",
            f"< {STOP_S:g}",
            f"{statistics.median(took_s):.2f}, {slowest_s:.2f}",
            slowest_s < STOP_S,
        ),
        Count("of all cores, rigs and watchers included", tried, "told only", f"{busy:.0f} %", kept=True),
    ]
