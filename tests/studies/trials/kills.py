"""Kills the service at random instants of a run, starts it anew, takes the run up again, and looks."""

from __future__ import annotations

import functools
import json
import math
import random
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from calrig.settings import BoardSettings, RigSettings, StageSettings
from calrig.simulator.config import SimulatorSettings
from calrig.simulator.rig import SimulatedRig

from .counting import Count, Extent, none_of
from .served import Served, configured, until

KILLS = 200
SECOND_KILL = 0.3
SLOW = 0.25
"""Share of runs whose stage looks for its reference longer than the service takes to come back."""
RUN_S = 5.0
"""About what a run takes, from the request to its end; a kill may also come just after it."""
DEADLINE_S = 120.0
STANDS_DPS = 1e-6

PLAN = {"elevations_deg": [-40, -20, 0, 20, 40], "sweeps": 4, "settle_s": 0.5, "dwell_s": 1.0}
RIG: dict[str, Any] = {
    "time_scale": 20.0,
    "stage": {"velocity_dps": 60.0, "acceleration_dps2": 240.0, "homing_velocity_dps": 30.0},
    "mechanics": {"backlash_deg": 0.1},
    "mount": {"offset_deg": 0.8},
    "imu": {"gyro_bias_dps": [1.4, -0.6, 0.3]},
}
SLOWLY = {
    "stage": {**RIG["stage"], "homing_velocity_dps": 1.5},
    "mechanics": {**RIG["mechanics"], "power_up_deg": 150.0},
}
"""Homes for five seconds of the wall's clock."""


@dataclass
class Outcome:
    """What one killed run came to; each list has a line for each failure."""

    lost: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    moving: list[str] = field(default_factory=list)
    kills: int = 0
    interrupted: bool = False
    moved_when_killed: int = 0


@contextmanager
def bench_rig(seed: int, *, slow: bool = False) -> Iterator[tuple[SimulatedRig, RigSettings]]:
    options = {**RIG, **(SLOWLY if slow else {}), "seed": seed}
    with SimulatedRig(SimulatorSettings.from_options(options)) as rig:
        yield (
            rig,
            RigSettings(
                name="bench-1",
                stage=StageSettings(driver="smc100", port=rig.stage_port),
                imu=BoardSettings(driver="calrig", port=rig.imu_port),
            ),
        )


def moves(rig: SimulatedRig, for_s: float = 300.0) -> bool:
    """Whether the table moves now or will, without another command, for so long."""
    with rig.bench.lock:
        now_s = rig.clock()
        rates = rig.bench.mechanics.table(np.arange(now_s, now_s + for_s, 0.05)).rate_dps
    return bool(np.abs(rates).max() > STANDS_DPS)


class _Listener(threading.Thread):
    """Takes the poses that a run announces until the service is gone."""

    def __init__(self, url: httpx.URL, run_id: str) -> None:
        super().__init__(daemon=True)
        self._url = url.join(f"/api/runs/{run_id}/events")
        self.poses: dict[int, dict[str, Any]] = {}

    def run(self) -> None:
        kind = ""
        try:
            with httpx.stream("GET", self._url, timeout=None) as answer:
                for line in answer.iter_lines():
                    if line.startswith("event:"):
                        kind = line.removeprefix("event:").strip()
                    elif line.startswith("data:") and kind == "pose":
                        pose = json.loads(line.removeprefix("data:"))
                        self.poses[pose.pop("index")] = pose
        except httpx.HTTPError:
            return  # the service was killed


@functools.cache
def _undisturbed() -> dict[str, Any]:
    """The result of the same plan on a rig that nobody disturbs."""
    with tempfile.TemporaryDirectory() as folder, bench_rig(10_000) as (_, settings):
        served = Served(configured(Path(folder), [settings]), Path(folder) / "calrig.db")
        try:
            run = _begin(served)
            ended = _ended(served, run["id"])
            if ended is None or ended["status"] != "completed":
                raise RuntimeError(f"the undisturbed run did not complete: {ended}")
            return dict(ended["result"])
        finally:
            served.terminate()


def _begin(served: Served) -> dict[str, Any]:
    body = {"unit": "AS-1", "plan": PLAN}
    return dict(served.client.post("/api/runs", json=body).raise_for_status().json())


def _ended(served: Served, run_id: str) -> dict[str, Any] | None:
    def look() -> dict[str, Any] | None:
        run: dict[str, Any] = served.get(f"/api/runs/{run_id}")
        return run if run["status"] not in {"queued", "running", "paused"} else None

    return until(look, DEADLINE_S)


def kill_one(seed: int) -> Outcome:
    """One run, killed once or twice, and resumed."""
    rng = random.Random(seed)
    slow = rng.random() < SLOW
    kills = 2 if rng.random() < SECOND_KILL else 1
    out, where = Outcome(), f"seed {seed}"
    with tempfile.TemporaryDirectory() as name, bench_rig(seed, slow=slow) as (rig, settings):
        folder = Path(name)
        config, store = configured(folder, [settings]), folder / "calrig.db"
        served = Served(config, store)
        run_id = _begin(served)["id"]
        announced: dict[int, dict[str, Any]] = {}
        for _ in range(kills):
            listener = _Listener(served.client.base_url, run_id)
            listener.start()
            threading.Event().wait(rng.uniform(0.0, RUN_S))
            served.kill()
            out.kills += 1
            out.moved_when_killed += moves(rig, 0.1)
            listener.join()
            announced |= listener.poses
            served = Served(config, store)
            if moves(rig):
                out.moving.append(f"{where}: the stage moves when the service is back")
            stored = served.get(f"/api/runs/{run_id}/poses")
            out.lost += [
                f"{where}: pose {k}"
                for k, pose in announced.items()
                if k >= len(stored) or any(stored[k][key] != value for key, value in pose.items())
            ]
            left = served.get(f"/api/runs/{run_id}")
            if left["status"] == "completed":
                break  # the kill came after the end
            if left["status"] != "interrupted":
                out.wrong.append(f"{where}: the run is {left['status']}: {left['error']}")
                break
            out.interrupted = True
            served.client.post(f"/api/runs/{run_id}/resume").raise_for_status()
        ended = _ended(served, run_id)
        out.wrong += [f"{where}: {line}" for line in _judged(ended, out)]
        if moves(rig):
            out.moving.append(f"{where}: the stage moves after the run's end")
        served.terminate()
    return out


def _judged(ended: dict[str, Any] | None, out: Outcome) -> list[str]:
    """What is wrong with a run that was resumed."""
    if ended is None:
        return [f"no end within {DEADLINE_S:g} s"]
    if ended["status"] != "completed":
        return [f"{ended['status']}: {ended['error']}"]
    found, calm = ended["result"], _undisturbed()
    wrong = [
        f"{name} is {found[name]:.5f}, {calm[name]:.5f} undisturbed"
        for name, std in (("bias_deg", "bias_std_deg"), ("scale", "scale_std"))
        if abs(found[name] - calm[name]) > 4 * math.hypot(found[std], calm[std])
    ]
    if found["n_poses"] != calm["n_poses"]:
        wrong.append(f"{found['n_poses']} poses, {calm['n_poses']} undisturbed")
    told = len(ended["provenance"].get("interruptions", []))
    if out.interrupted and not 1 <= told <= out.kills:
        wrong.append(f"it tells of {told} interruptions")
    return wrong


def trial(extent: Extent) -> list[Count]:
    """200 kills at random instants."""
    number = extent.of(KILLS)
    seeds = [1000 * extent.seed + k for k in range(number)]
    with ProcessPoolExecutor(extent.workers, mp_context=get_context("spawn")) as workers:
        outcomes = list(workers.map(kill_one, seeds))
    tried = f"{sum(o.kills for o in outcomes)} kills of {number} runs"
    interrupted = sum(o.interrupted for o in outcomes)
    wrong = [line for o in outcomes for line in o.wrong]
    return [
        none_of("poses announced and lost", tried, [line for o in outcomes for line in o.lost]),
        Count(
            "runs with a right result in the end",
            f"{number} ({interrupted} interrupted and resumed)",
            "all",
            str(sum(not o.wrong for o in outcomes)),
            not wrong,
            tuple(wrong),
        ),
        none_of(
            "stage left moving",
            f"{tried}, {sum(o.moved_when_killed for o in outcomes)} on the move",
            [line for o in outcomes for line in o.moving],
        ),
    ]
