"""What the diagnosis says of runs whose causes only their rigs know: sweeps beside the fixed plan.

`python -m tests.studies.sweeps.blind --runs 8`: both plans over ports of simulated rigs in virtual time,
for every world of `worlds`; the sweep is the one that is designed for the uncertainty of the fixed plan, with
effects to be traced.
"""

from __future__ import annotations

import argparse
import logging
import os
import pickle
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # inherited by the workers: one core each

from calrig.calibration.diagnosis.tracing import diagnose, document
from calrig.calibration.plan_design.design import quickest
from calrig.calibration.plan_design.design_problem import Goals
from calrig.calibration.poses import Pose
from calrig.calibration.uncertainty.budget import Reference
from calrig.plan import Plan
from tests.studies.blind.board import suspects, words
from tests.studies.plans import trial

from .rigs import carried_out
from .worlds import WORLDS, options

MAP = Reference(0.003, "harmonic", "normal")
UNCERTAINTY_RUNS = 500
STANDING_TIME_SCALE = 3.0
"""Of rigs that stop: fewer looks at their ports, and no time counts there but the board's."""


class Planned(NamedTuple):
    """A plan, and how long a run of it takes, s."""

    plan: Plan
    lasts_s: float


def plans() -> dict[str, Planned]:
    """The fixed plan, and the sweep designed for what that states."""
    fixed = trial.fixed()
    task = trial.task(MAP, trace=True, sweeping=True)
    design = quickest(task, Goals(trial.kept(fixed, MAP, UNCERTAINTY_RUNS).stated_deg))
    assert design.sweep is not None
    turning = design.sweep.plan(task.seed).model_copy(update={"settle_s": trial.SETTLE_S})
    return {"fixed": Planned(Plan(), trial.stage_time_s(fixed)), "sweep": Planned(turning, design.duration_s)}


class Task(NamedTuple):
    """One run, for a worker; with `poses` its poses are kept in that folder, and taken from there."""

    plan: str
    planned: Planned
    world: str
    seed: int
    poses: Path | None


@dataclass(frozen=True)
class Judgement:
    """One run.

    Attributes:
        said: what the diagnosis lists, in short; of a run that failed, why.
        refused: the run failed.
        found: something was found.
        held: a right name is among the suspects of an effect.
        alone: one effect, of a right name and no other.
        wrong: an effect has a single name, and not a right one.
    """

    said: str
    refused: bool = False
    found: bool = False
    held: bool = False
    alone: bool = False
    wrong: bool = False


def judge(task: Task) -> tuple[Task, Judgement]:
    """Carries the run out, diagnoses it blind and holds that against its world."""
    logging.disable()
    taken = _poses(task)
    if isinstance(taken, str):
        return task, Judgement(taken, refused=True)
    effects = document(diagnose([taken], seed=task.seed, cross_fit=False), [""])["effects"]
    right = WORLDS[task.world].right
    named = [effect["name"] for effect in effects if effect["verdict"] == "named"]
    return task, Judgement(
        said="; ".join(words(effect) for effect in effects) or "nothing",
        found=bool(effects),
        held=any(suspects(effect) & right for effect in effects),
        alone=bool(effects) and len(named) == len(effects) and set(named) <= right,
        wrong=any(name not in right for name in named),
    )


def _poses(task: Task) -> list[Pose] | str:
    """Of the run; the reason where it failed."""
    kept = task.poses and task.poses / f"{task.plan} {task.world} {task.seed}.pickle".replace("/", "_")
    if kept and kept.exists():
        return pickle.loads(kept.read_bytes())
    with tempfile.TemporaryDirectory() as folder:
        made = options(WORLDS[task.world], task.seed, task.planned.lasts_s)
        pace = {"time_scale": STANDING_TIME_SCALE} if task.planned.plan.kind != "sweep" else {}
        run, poses = carried_out({**made, **pace}, task.seed, Path(folder), task.planned.plan)
    taken = poses if run.status == "completed" else run.error or run.status
    if kept:
        kept.write_bytes(pickle.dumps(taken))
    return taken


COLUMNS = {
    "found": "found",
    "held": "a right name among its suspects",
    "alone": "that alone",
    "wrong": "a wrong single name",
    "refused": "refused",
}


def table(judged: Mapping[tuple[str, str], list[Judgement]]) -> Iterable[str]:
    """Of Markdown, a row a world, each cell of the plans in their order."""
    yield f"| what is wrong | {' | '.join(COLUMNS.values())} | said of most |"
    yield f"| {' | '.join(['---'] * (len(COLUMNS) + 2))} |"
    for world in dict.fromkeys(world for world, _ in judged):
        of_plans = [those for (name, _), those in judged.items() if name == world]
        cells = [", ".join(_times(those, what) for those in of_plans) for what in COLUMNS]
        yield f"| {world} | {' | '.join(cells)} | {'; '.join(map(_commonest, of_plans))} |"


def _times(those: list[Judgement], what: str) -> str:
    of = those if what == "refused" else [one for one in those if not one.refused]
    return f"{sum(getattr(one, what) for one in of)} of {len(of)}"


def _commonest(those: list[Judgement]) -> str:
    said = [one.said for one in those]
    most = max(said, key=said.count)
    return f"{most} ×{said.count(most)}"


def main() -> None:
    """Judges every run and prints the table."""
    asked = argparse.ArgumentParser(prog="python -m tests.studies.sweeps.blind", description=__doc__)
    asked.add_argument("--runs", type=int, default=8, help="of each world and plan")
    asked.add_argument("--first-seed", type=int, default=0)
    asked.add_argument("--worlds", nargs="*", default=[""], help="beginnings of names; all without it")
    asked.add_argument("--plans", nargs="*", default=["fixed", "sweep"])
    asked.add_argument("--processes", type=int, default=2)
    asked.add_argument("--poses", type=Path, help="folder of runs, to diagnose them again")
    given = asked.parse_args()
    known = plans()
    tasks = [
        Task(plan, known[plan], world, seed, given.poses)
        for seed in range(given.first_seed, given.first_seed + given.runs)
        for world in WORLDS
        for plan in given.plans
        if world.startswith(tuple(given.worlds))
    ]
    judged: dict[tuple[str, str], list[Judgement]] = defaultdict(list)
    with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
        for done, (task, judgement) in enumerate(pool.map(judge, tasks), start=1):
            judged[task.world, task.plan].append(judgement)
            sys.stderr.write(
                f"{done} of {len(tasks)}: {task.world}, {task.plan} {task.seed}: {judgement.said}\n"
            )
    for row in table(judged):
        sys.stdout.write(f"{row}\n")


if __name__ == "__main__":
    main()
