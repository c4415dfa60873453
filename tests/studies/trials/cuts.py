"""Cuts agent, network, centre and PostgreSQL at random instants of runs that a centre has ordered, and looks.

A run goes on by itself where the bench lives. Where the agent was killed it is interrupted, or held back if
it had not begun, and a person resumes it at the centre. What the stage was told is read from the transcript
of its wire.
"""

from __future__ import annotations

import itertools
import random
import re
import tempfile
import threading
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import httpx

from .centre import Bench, Centre, centre
from .counting import Count, Extent, none_of
from .kills import PLAN, RUN_S, bench_rig, moves
from .served import until

CUTS = 1000
AT_A_CENTRE = 25
"""Runs on one centre before the next one: its start takes several seconds."""
KINDS = ("agent", "network", "black hole", "dead connections", "half delivery", "centre", "postgresql")
"""In a black hole connections stay open and pass nothing on, until it is mended; dead connections never do,
and new ones are whole. In half a delivery half of a parcel goes first.
"""
MOST_CUTS = 3
AWAY_S = (0.0, 2.0)
LONG_S, LONG = 20.0, 0.1
"""This share of the black holes lasts longer than a bench acts on orders without its centre."""
PARCEL_S = 3.0
"""A run under way delivers within it."""
DEADLINE_S = 180.0
POSES = 20
MOVE = re.compile(rb"1PA(-?[0-9.]+)")


@dataclass
class Outcome:
    """What the runs at one centre came to; each list has a line for each failure."""

    cuts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    runs: int = 0
    resumed: int = 0
    twice_moved: list[str] = field(default_factory=list)
    poses: list[str] = field(default_factory=list)
    endless: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


def _cut(at: Centre, bench: Bench, kind: str, away_s: float) -> bool:
    """Cuts one of them and mends it again after a while; returns whether there was something to cut."""
    if kind == "half delivery":
        if not at.server.cable.halve(PARCEL_S):
            return False
        threading.Event().wait(away_s)
        at.server.cable.mend()
    elif kind == "black hole":
        at.server.cable.swallow()
        threading.Event().wait(away_s)
        at.server.cable.mend()
    elif kind == "dead connections":
        at.server.cable.strand()
    elif kind == "agent":
        bench.kill()
        threading.Event().wait(away_s)
        bench.start()
    elif kind == "network":
        at.server.cable.cut()
        threading.Event().wait(away_s)
        at.server.cable.mend()
    elif kind == "centre":
        at.served[0].kill()
        threading.Event().wait(away_s)
        at.served[0] = at.serve(0)
    else:
        at.server.crash()
        threading.Event().wait(away_s)
        at.server.start()
    return True


def _asked(at: Centre, method: str, path: str, **body: Any) -> httpx.Response | None:
    """The answer of a centre that may be coming up; None where it does not say yes."""
    try:
        answer = at.served[0].client.request(method, path, **body)
    except httpx.HTTPError:
        return None
    return answer if answer.is_success else None


def _run_of(at: Centre, run_id: str) -> dict[str, Any] | None:
    answer = _asked(at, "GET", f"/api/runs/{run_id}")
    return None if answer is None else answer.json()


def to_its_end(at: Centre, run_id: str, out: Outcome | None = None) -> dict[str, Any] | None:
    """The run once it is completed; resumes it where it was interrupted or is held back, as a person does."""
    out = out or Outcome()

    def look() -> dict[str, Any] | None:
        run = _run_of(at, run_id)
        is_held = run is not None and run["status"] == "queued" and run["error"]
        if run is not None and (run["status"] == "interrupted" or is_held):
            out.resumed += _asked(at, "POST", f"/api/runs/{run_id}/resume") is not None
        return run if run is not None and run["status"] in {"completed", "failed", "aborted"} else None

    return until(look, DEADLINE_S)


def moves_told(bench: Bench) -> int:
    """How many moves to an angle the stage was told, in all transcripts."""
    return sum(len(MOVE.findall(file.read_bytes())) for file in (bench.folder / "wires").rglob("*stage*"))


def cut_some(seed: int, runs: int) -> Outcome:
    """Runs one after the other on one bench, each cut up to three times."""
    rng, out = random.Random(seed), Outcome()
    in_turn = itertools.cycle(rng.sample(KINDS, len(KINDS)))
    with (
        tempfile.TemporaryDirectory() as name,
        bench_rig(seed) as (rig, settings),
        centre(Path(name)) as at,
    ):
        bench = at.join("hall", [settings], by_cable=True)
        until(lambda: at.served[0].get("/api/rigs") or None, DEADLINE_S)
        undisturbed = None
        for k in range(1 + runs):
            where = f"seed {seed}, run {k}"
            told = moves_told(bench)
            body = {"unit": f"U{k}", "rig": settings.name, "plan": PLAN}
            begun = until(lambda body=body: _asked(at, "POST", "/api/runs", json=body), DEADLINE_S)
            if begun is None:
                out.endless.append(f"{where}: it could not be begun")
                break
            run_id, kinds = begun.json()["id"], []
            for _ in range(rng.randint(1, MOST_CUTS) if k else 0):
                threading.Event().wait(rng.uniform(0.0, RUN_S))
                kinds.append(next(in_turn))
                is_long = kinds[-1] == "black hole" and rng.random() < LONG
                away_s = LONG_S if is_long else rng.uniform(*AWAY_S)
                out.cuts[kinds[-1]] += _cut(at, bench, kinds[-1], away_s)
            where = f"{where}, {', '.join(kinds)}"
            run = to_its_end(at, run_id, out)
            out.runs += 1
            if run is None:
                out.endless.append(f"{where}: {(_run_of(at, run_id) or {}).get('status')}")
                continue
            if run["status"] != "completed":
                out.wrong.append(f"{where}: {run['status']}: {run['error']}")
            out.poses += wrong_poses(at, run_id, where, POSES)
            moved = moves_told(bench) - told
            undisturbed = undisturbed or moved
            if "agent" not in kinds and moved != undisturbed:
                out.twice_moved.append(f"{where}: {moved} moves, {undisturbed} undisturbed")
            if moves(rig):
                out.twice_moved.append(f"{where}: the stage moves after the run's end")
    return out


def wrong_poses(at: Centre, run_id: str, where: str, expected: int) -> list[str]:
    """A line for each pose that is not there once, in the table and among the events in their order."""
    indices = [pose["index"] for pose in at.served[0].get(f"/api/runs/{run_id}/poses")]
    wrong = [f"{where}: pose {k} is lost" for k in range(expected) if k not in indices]
    announced, numbers = [], []
    for line in at.served[0].client.get(f"/api/runs/{run_id}/events", timeout=DEADLINE_S).text.splitlines():
        if line.startswith("id:"):
            numbers.append(int(line.removeprefix("id:")))
        if line.startswith("event: pose"):
            announced.append(line)
    if len(indices) != len(set(indices)) or len(announced) != len(indices):
        wrong.append(f"{where}: {len(indices)} poses, {len(announced)} announced")
    if numbers != list(range(1, len(numbers) + 1)):
        wrong.append(f"{where}: events {numbers[:3]} … are not numbered in order")
    return wrong


def trial(extent: Extent) -> list[Count]:
    """1,000 cuts at random instants."""
    runs = -(-extent.of(CUTS) * 2 // (1 + MOST_CUTS))
    seeds = [
        (100 * extent.seed + k, min(AT_A_CENTRE, runs - first))
        for k, first in enumerate(range(0, runs, AT_A_CENTRE))
    ]
    with ProcessPoolExecutor(extent.workers, mp_context=get_context("spawn")) as workers:
        outcomes = list(workers.map(cut_some, *zip(*seeds, strict=True)))
    cuts = {kind: sum(o.cuts[kind] for o in outcomes) for kind in KINDS}
    told = ", ".join(f"{kind} {number}" for kind, number in cuts.items())
    tried = f"{sum(cuts.values())} cuts ({told}) of {sum(o.runs for o in outcomes)} runs"
    return [
        none_of("moves made twice", tried, [line for o in outcomes for line in o.twice_moved]),
        none_of("poses lost or twice", tried, [line for o in outcomes for line in o.poses]),
        none_of("runs without an end", tried, [line for o in outcomes for line in o.endless]),
        none_of(
            f"runs that failed ({sum(o.resumed for o in outcomes)} times resumed)",
            tried,
            [line for o in outcomes for line in o.wrong],
        ),
    ]
