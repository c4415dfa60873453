"""The blind board in full: `python -m tests.blind [--runs N] [--nulls N] [--cells NAME …] [--markdown]`."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # inherited by the workers, who load numpy anew: one core each

from .board import Judgement, Task, judge_task
from .cells import CELLS
from .table import commonest, markdown


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="of each cell with an effect")
    parser.add_argument(
        "--nulls", type=int, default=None, help="of each cell of noise alone; ten times --runs"
    )
    parser.add_argument("--cells", nargs="*", default=None, help="beginnings of names; all without it")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--no-cross-fit", action="store_true", help="quicker; without held-out errors")
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--markdown", action="store_true", help="the table alone, for the README")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every judgement, one a line")
    return parser.parse_args()


def main() -> None:
    """Judges every run and prints the table."""
    wanted = _arguments()
    nulls = 10 * wanted.runs if wanted.nulls is None else wanted.nulls
    tasks = []
    for name, cell in CELLS.items():
        if wanted.cells and not any(name.startswith(beginning) for beginning in wanted.cells):
            continue
        null = cell.kind == "null"
        seeds = range(wanted.first_seed, wanted.first_seed + (nulls if null else wanted.runs))
        tasks += [
            Task(name, seed, not null and not wanted.no_cross_fit, not wanted.no_peers) for seed in seeds
        ]
    judged: dict[str, list[Judgement]] = defaultdict(list)
    with ExitStack() as stack:
        log = stack.enter_context(wanted.json.open("w", encoding="utf-8")) if wanted.json else None
        workers = stack.enter_context(ProcessPoolExecutor(wanted.workers, mp_context=get_context("spawn")))
        for done, (name, seed, judgement) in enumerate(workers.map(judge_task, tasks, chunksize=4), start=1):
            judged[name].append(judgement)
            if log is not None:
                line = {"cell": name, "seed": seed, **asdict(judgement)}
                log.write(json.dumps(line, ensure_ascii=False) + "\n")
            if done % 20 == 0 or done == len(tasks):
                sys.stderr.write(f"\r{done} of {len(tasks)} runs, {name}  ")
    sys.stderr.write("\n")
    sys.stdout.write(markdown(judged))
    if not wanted.markdown:
        for name, judgements in judged.items():
            sys.stdout.write(f"{name}: {commonest(judgements)}\n")


if __name__ == "__main__":
    main()
