"""What `calrig fleet` takes of a store, and what it finds: `python -m tests.studies.fleet.stored FILE`.

Runs of 100 poses by the simulator's physics. A tenth have one of 17 causes, each at the size that a diagnosis
just sees; some runs are damaged in the store. FILE is made where it is not there yet. `calrig fleet` then
runs as a process; memory is that of all its processes together, the highest in each quarter of the time.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from sqlalchemy import create_engine, text

from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.store import Store
from studies.blind.cells import CELLS

from .limit_runs import MAKES, at_the_limit
from .measuring import Memory, processor_s

EVERY = 10
"""Of so many runs one has a cause."""
DAMAGED = 5
UNITS, RIGS = 500, 40
TOGETHER = 200


def main() -> int:
    """Makes the store, reads it once more, and prints a table; exit status 1 if a damaged run ended it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--runs", type=int, default=10_000)
    options = parser.parse_args()
    planted = options.file.with_suffix(".planted.json")
    if not options.file.exists():
        planted.write_text(json.dumps(_made(options.file, options.runs)))
    causes: dict[str, str] = json.loads(planted.read_text())
    command = [sys.executable, "-m", "calrig", "fleet", "--json", "--db", str(options.file)]
    with Memory() as memory:
        began_s, spent_s = time.monotonic(), processor_s()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        wall_s, spent_s = time.monotonic() - began_s, processor_s() - spent_s
    if done.returncode:
        sys.stderr.write(done.stderr)
        return 1
    return _told(json.loads(done.stdout), causes, wall_s, spent_s, memory.held_mb)


def _told(
    found: dict[str, Any], causes: dict[str, str], wall_s: float, spent_s: float, held_mb: list[float]
) -> int:
    changed = {one["run_id"]: one["verdict_now"] for one in found["changed"]}
    verdicts = Counter(changed[run_id] for run_id in causes if run_id in changed)
    quarter = max(1, len(held_mb) // 4)
    quarters = [max(held_mb[k : k + quarter]) for k in range(0, 4 * quarter, quarter) if held_mb[k:]]
    seen = sum(verdicts.values())
    rows = {
        "runs": f"{found['runs']:,}, {len(causes):,} with a cause",
        "wall time": f"{wall_s / 60:.1f} min",
        "processor time": f"{spent_s / 60:.1f} min",
        "memory, highest in each quarter": ", ".join(f"{most:.0f}" for most in quarters) + " MB",
        "runs with a cause in which something was found": f"{seen} ({dict(verdicts)})",
        "runs without one in which something was found": str(len(changed.keys() - causes.keys())),
        "damaged runs, each a line of the report": f"{len(found['failed'])} of {DAMAGED}",
    }
    sys.stdout.writelines(f"| {what} | {value} |\n" for what, value in rows.items())
    return 0 if len(found["failed"]) == DAMAGED else 1


def _made(file: Path, n_runs: int) -> dict[str, str]:
    """Lay the store; returns the cause of each run that has one, by the run's id."""
    causes: dict[str, str] = {}
    url = f"sqlite:///{file}"
    workers = ProcessPoolExecutor(os.cpu_count() or 1, get_context("spawn"))
    with workers, Store.open(url, writer="tests") as store:
        for first in range(0, n_runs, TOGETHER):
            numbers = range(first, min(first + TOGETHER, n_runs))
            made = list(workers.map(_run, numbers, chunksize=10))
            for k, (cause, poses, result) in zip(numbers, made, strict=True):
                run = store.runs.create(
                    unit=f"U{k % UNITS:03}",
                    rig=f"bench-{k % RIGS}",
                    plan=None,
                    status="completed",
                    provenance={},
                    poses=poses,
                    result=result,
                )
                if cause is not None:
                    causes[run.id] = cause
    engine = create_engine(url)
    with engine.begin() as connection:
        spoil = (
            f"UPDATE pose SET reading_deg = reading_deg + 1 WHERE run_id % {max(1, n_runs // DAMAGED)} = 1"
        )
        connection.execute(text(spoil))
    engine.dispose()
    return causes


def _run(k: int) -> tuple[str | None, list[Pose], dict[str, Any]]:
    cause = [*MAKES][k // EVERY % len(MAKES)] if k % EVERY == 5 else None
    poses = CELLS["null white"].run(k).poses if cause is None else at_the_limit(cause, k)
    return cause, poses, build_result(poses).to_dict()


if __name__ == "__main__":
    sys.exit(main())
