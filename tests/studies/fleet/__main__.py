"""What a screen of many runs takes: `python -m tests.studies.fleet --runs 1000000 DIR`.

Runs of 100 poses by the simulator's physics, a twentieth with a backlash at the diagnosis' limit, are written
to DIR as Parquet (32 bytes a pose), kept there for the next time, and screened by one process and by two:
from the files, and from packed poses in memory, of which one piece is screened again and again.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from calrig.analysis.fleet import glance_at_files
from calrig.export.poses_parquet import write_poses

from .made import RUNS_A_PIECE, fleet, screened_again
from .measuring import Memory, processor_s

AT_THE_LIMIT = "limit backlash 0.038°"


def main() -> None:
    """Makes the fleet where it is not there yet, and prints a line of Markdown for each trial."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--cores", type=int, nargs="+", default=[1, 2])
    options = parser.parse_args()
    pieces = max(1, options.runs // RUNS_A_PIECE)
    for k in range(pieces):
        folder = options.folder / f"{k:04}"
        if not folder.exists():
            cell = AT_THE_LIMIT if k % 20 == 0 else "null white"
            write_poses(folder, [fleet(RUNS_A_PIECE, 1, k * RUNS_A_PIECE, cell=cell)])
    files = sorted(options.folder.glob("*/*.parquet"))[:pieces]
    _say("| from | cores | runs | wall, s | processor, s | µs a run | stand out | memory, MB |")
    _say(8 * "| --- " + "|")
    for cores in options.cores:
        _measured("Parquet", cores, lambda cores=cores: _of_files(files, cores))
        _measured("packed poses", cores, lambda cores=cores: _of_memory(pieces, cores))


def _of_files(files: list[Path], cores: int) -> tuple[int, int]:
    runs = stood_out = 0
    for answer in glance_at_files(files, slots=cores):
        runs += sum(len(one.run_ids) for one in answer)
        stood_out += sum(len(one.standing_out) for one in answer)
    return runs, stood_out


def _of_memory(pieces: int, cores: int) -> tuple[int, int]:
    with ProcessPoolExecutor(cores, get_context("spawn")) as pool:
        found = list(pool.map(screened_again, [pieces // cores + (k < pieces % cores) for k in range(cores)]))
    return sum(runs for runs, _ in found), sum(stood_out for _, stood_out in found)


def _measured(what: str, cores: int, trial: Callable[[], tuple[int, int]]) -> None:
    """Prints a trial: time, and the most memory that it and its processes held at once."""
    with Memory() as memory:
        began_s, spent_s = time.monotonic(), processor_s()
        runs, stood_out = trial()
        wall_s, spent_s = time.monotonic() - began_s, processor_s() - spent_s
    per_run_us = 1e6 * spent_s / runs
    _say(
        f"| {what} | {cores} | {runs:,} | {wall_s:.1f} | {spent_s:.1f} | {per_run_us:.0f} "
        f"| {stood_out / runs:.4f} | {memory.most_mb:.0f} |"
    )


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
