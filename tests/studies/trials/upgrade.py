"""Upgrades a centre and its bench from the version with the schema before this one's, during runs, and looks.

In the order that the documentation gives: the centre first, each bench once its run has ended. The older
version is the last commit without the newest migration.
"""

from __future__ import annotations

import io
import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import Any

from calrig.settings import packed
from calrig.store.database import revisions

from .centre import Bench, Centre, centre
from .counting import Count, Extent, none_of
from .cuts import DEADLINE_S, moves_told, to_its_end, wrong_poses
from .kills import PLAN, bench_rig
from .served import HERE, of_program, until

LONG = {**PLAN, "sweeps": 16}
"""Of some twenty seconds: it runs while the centre is upgraded."""


def _older(folder: Path) -> str | None:
    """Lay the older version into a folder; returns its commit, None without the repository's history."""
    repository = packed("migrations").parent
    (newest,) = (packed("migrations") / "versions").glob(f"{revisions()[-1]}_*.py")

    def git(*command: str) -> bytes:
        return subprocess.run(["git", *command], cwd=repository, capture_output=True, check=True).stdout

    try:
        added = git("log", "--diff-filter=A", "--format=%H", "--", str(newest)).decode().split()[-1]
        archive = git("archive", f"{added}~1")
    except (OSError, subprocess.CalledProcessError, IndexError):
        return None
    with tarfile.open(fileobj=io.BytesIO(archive)) as packed_files:
        packed_files.extractall(folder, filter="data")
    return git("rev-parse", "--short", f"{added}~1").decode().strip()


def _refusal(at: Centre) -> str | None:
    """Why the bench takes no orders, as the page says it."""
    (bench,) = at.served[0].get("/api/benches/overview")
    refused: str | None = bench.get("refused")
    return refused


def _begin(at: Centre, plan: dict[str, Any], **more: Any) -> str:
    body = {"unit": "U", "rig": "bench-1", "plan": plan, **more}
    run_id: str = at.served[0].client.post("/api/runs", json=body).raise_for_status().json()["id"]
    return run_id


def _upgrade(at: Centre, bench: Bench) -> list[str]:
    """Upgrade both during a run; returns a line for each thing that is not as documented."""
    wrong: list[str] = []
    until(lambda: at.served[0].get("/api/rigs") or None, DEADLINE_S)
    undisturbed = moves_told(bench)
    to_its_end(at, _begin(at, PLAN))
    undisturbed = moves_told(bench) - undisturbed
    before = moves_told(bench)
    running = _begin(at, LONG)
    until(lambda: at.served[0].get(f"/api/runs/{running}/poses") or None, DEADLINE_S)
    waiting = _begin(at, PLAN, queue=True)
    at.served[0].terminate()
    at.program = HERE
    at.served[0] = at.serve(0)
    if at.served[0].get(f"/api/runs/{running}")["status"] != "running":
        wrong.append("the run had ended before the centre was upgraded")
    refused = until(lambda: _refusal(at), DEADLINE_S)
    if "too old for the centre" not in (refused or ""):
        wrong.append(f"the older bench is not refused: {refused}")
    run = to_its_end(at, running)
    wrong += wrong_poses(at, running, f"the run of the older bench ({run and run['status']})", 80)
    kept = at.served[0].get(f"/api/runs/{waiting}")
    if kept["status"] != "queued":
        wrong.append(f"the run that waited is {kept['status']} before the bench was upgraded")
    bench.terminate()
    bench.program = HERE
    bench.start()
    until(lambda: None if _refusal(at) else True, DEADLINE_S)
    if refused := _refusal(at):
        wrong.append(f"the upgraded bench is refused: {refused}")
    (told,) = at.served[0].get("/api/benches")
    if told["schema_revision"] != revisions()[-1]:
        wrong.append(f"the upgraded bench tells schema {told['schema_revision']}")
    run = to_its_end(at, waiting)
    wrong += wrong_poses(at, waiting, f"the run that waited ({run and run['status']})", 20)
    moved = moves_told(bench) - before
    if moved != 5 * undisturbed:
        wrong.append(f"{moved} moves of runs that take {5 * undisturbed} undisturbed")
    return wrong


def trial(extent: Extent) -> list[Count]:
    """One upgrade, whatever the share."""
    with tempfile.TemporaryDirectory() as name:
        older = _older(Path(name) / "older")
        if older is None:
            return [Count("upgrades", "no history here", "told only", "not tried", kept=True)]
        program = of_program(Path(name) / "older")
        with bench_rig(extent.seed) as (_, settings), centre(Path(name), program=program) as at:
            wrong = _upgrade(at, at.join("hall", [settings]))
    return [none_of("things that an upgrade during runs did wrong", f"from {older}", wrong)]
