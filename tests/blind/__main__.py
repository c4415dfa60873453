"""The blind board in full: `python -m tests.blind [--runs N] [--nulls N] [--cells NAME …] [--markdown]`.

With `--worlds [NAME …]` the other worlds in place of the first board's cells.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TextIO, TypeVar

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # inherited by the workers, who load numpy anew: one core each

from .board import Judgement, Task, judge_task
from .cells import CELLS
from .table import commonest, markdown
from .world_board import WorldJudgement, WorldTask, judge_world_task
from .world_table import by_cell
from .world_table import markdown as worlds_markdown
from .worlds import NULLS, WORLDS

DEARER = 10
"""Times as long as others, as a diagnosis of a thousand poses takes: of those so many fewer runs."""
T, J = TypeVar("T"), TypeVar("J")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="of each cell with an effect")
    parser.add_argument(
        "--nulls", type=int, default=None, help="of each cell of noise alone; ten times --runs"
    )
    parser.add_argument("--cells", nargs="*", default=None, help="beginnings of names; all without it")
    parser.add_argument("--worlds", nargs="*", default=None, help="beginnings of names; all without one")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--no-cross-fit", action="store_true", help="quicker; without held-out errors")
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--markdown", action="store_true", help="the table of docs/validation/diagnosis.md")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every judgement, one a line")
    return parser.parse_args()


def main() -> None:
    """Judges every run and prints the table."""
    wanted = _arguments()
    if wanted.worlds is None:
        _first_board(wanted)
    else:
        _worlds(wanted)


def _begins(name: str, beginnings: list[str] | None) -> bool:
    return not beginnings or any(name.startswith(beginning) for beginning in beginnings)


def _first_board(wanted: argparse.Namespace) -> None:
    nulls = 10 * wanted.runs if wanted.nulls is None else wanted.nulls
    tasks = []
    for name, cell in CELLS.items():
        if not _begins(name, wanted.cells):
            continue
        null = cell.kind == "null"
        seeds = range(wanted.first_seed, wanted.first_seed + (nulls if null else wanted.runs))
        tasks += [
            Task(name, seed, not null and not wanted.no_cross_fit, not wanted.no_peers) for seed in seeds
        ]
    judged: dict[str, list[Judgement]] = defaultdict(list)
    with ExitStack() as stack:
        log = _log(wanted, stack)
        for done, (name, seed, judgement) in enumerate(_map(wanted, stack, judge_task, tasks), start=1):
            judged[name].append(judgement)
            _keep(log, {"cell": name, "seed": seed, **asdict(judgement)})
            _tell(done, len(tasks), name)
    sys.stdout.write(markdown(judged))
    if not wanted.markdown:
        for name, judgements in judged.items():
            sys.stdout.write(f"{name}: {commonest(judgements)}\n")


def _worlds(wanted: argparse.Namespace) -> None:
    nulls = 10 * wanted.runs if wanted.nulls is None else wanted.nulls
    tasks = []
    for name, world in WORLDS.items():
        if not _begins(name, wanted.worlds):
            continue
        for cell in (*world.cells, *world.nulls):
            if not _begins(cell, wanted.cells):
                continue
            runs = nulls if cell in NULLS else wanted.runs
            runs = max(runs // DEARER, 1) if world.dear else runs
            seeds = range(wanted.first_seed, wanted.first_seed + runs)
            cross_fit = cell not in NULLS and not wanted.no_cross_fit
            tasks += [WorldTask(name, cell, seed, cross_fit) for seed in seeds]
    judged: dict[tuple[str, str], list[WorldJudgement]] = defaultdict(list)
    with ExitStack() as stack:
        log = _log(wanted, stack)
        for done, (task, judgement) in enumerate(_map(wanted, stack, judge_world_task, tasks), start=1):
            judged[task.world, task.cell].append(judgement)
            _keep(log, {**task._asdict(), **asdict(judgement)})
            _tell(done, len(tasks), task.world)
    sys.stdout.write(worlds_markdown(judged))
    if not wanted.markdown:
        sys.stdout.write(by_cell(judged))


def _map(
    wanted: argparse.Namespace, stack: ExitStack, judge: Callable[[T], J], tasks: list[T]
) -> Iterator[J]:
    """Judgements as they come, of as many workers as are wanted."""
    workers = stack.enter_context(ProcessPoolExecutor(wanted.workers, mp_context=get_context("spawn")))
    return workers.map(judge, tasks, chunksize=4)


def _log(wanted: argparse.Namespace, stack: ExitStack) -> TextIO | None:
    return stack.enter_context(wanted.json.open("w", encoding="utf-8")) if wanted.json else None


def _keep(log: TextIO | None, line: dict[str, Any]) -> None:
    if log is not None:
        log.write(json.dumps(line, ensure_ascii=False) + "\n")
        log.flush()


def _tell(done: int, of: int, where: str) -> None:
    if done % 20 == 0 or done == of:
        sys.stderr.write(f"\r{done} of {of} runs, {where}  ")
    if done == of:
        sys.stderr.write("\n")


if __name__ == "__main__":
    main()
