"""The joint solution against its bound: `python -m tests.studies.joint [--seeds N] [--rigs N] [--minutes M]`.

With `--example FILE.csv` the poses of one such rig instead, for `calrig solve`. With `--three-axes` whole
units clamped by three faces, and their gyros; with `--peers` the same units beside other programs' methods.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # inherited by the workers

import numpy as np

from . import three_axes
from .cases import BOUNDS, COVERAGE, Case, Judged, judge

BATCH = 20


def main() -> None:
    """Prints both tables."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.joint", description=__doc__)
    parser.add_argument("--seeds", type=int, default=200, help="of each design beside its bound")
    parser.add_argument("--rigs", type=int, default=250, help="of each design for the coverage")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument(
        "--minutes", type=float, default=math.inf, help="stop each table's case after its share"
    )
    parser.add_argument("--example", type=Path, metavar="FILE.csv")
    parser.add_argument("--three-axes", action="store_true")
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    wanted = parser.parse_args()
    if wanted.example is not None:
        wanted.example.write_text(example(), encoding="utf-8")
        return
    if wanted.three_axes or wanted.peers:
        _of_whole_units(wanted)
        return
    share_s = 60.0 * wanted.minutes / (len(BOUNDS) + len(COVERAGE))
    with ProcessPoolExecutor(wanted.workers, mp_context=get_context("spawn")) as workers:
        sys.stdout.write(
            "| design | seeds | aim | bound | achieved | ratio | stated | orders |\n"
            "| --- | --- | --- | --- | --- | --- | --- | --- |\n"
        )
        for name, case in BOUNDS.items():
            judged = _judged(
                workers, case, range(wanted.first_seed, wanted.first_seed + wanted.seeds), share_s
            )
            sys.stdout.write(_beside_bound(name, case, judged))
            sys.stdout.flush()
        sys.stdout.write(
            "\n| 12 harmonics, cubic, play, drift | rigs | achieved | stated | coverage, k = 2 | its std |\n"
            "| --- | --- | --- | --- | --- | --- |\n"
        )
        for name, case in COVERAGE.items():
            judged = _judged(
                workers, case, range(wanted.first_seed, wanted.first_seed + wanted.rigs), share_s
            )
            sys.stdout.write(_covered(name, judged))
            sys.stdout.flush()


def _of_whole_units(wanted: argparse.Namespace) -> None:
    seeds = range(wanted.first_seed, wanted.first_seed + wanted.seeds)
    with ProcessPoolExecutor(wanted.workers, mp_context=get_context("spawn")) as workers:
        if wanted.three_axes:
            judged = partial(three_axes.judge)
            sys.stdout.write(three_axes.table(lambda cubic: workers.map(partial(judged, cubic=cubic), seeds)))
            sys.stdout.write("\n" + three_axes.gyro_table(workers.map(three_axes.judge_gyro, seeds)))
        if wanted.peers:
            from . import peers

            sys.stdout.write(peers.tables(workers, seeds) + peers.of_measured_logs())


def example() -> str:
    """A unit clamped at three angles of a stage of twelve harmonics, as CSV."""
    case = COVERAGE["{0, 1, 3}·360/7, full turn"]
    lots = case.bench(0).measured(np.random.default_rng(0))
    names = ("target_deg", "stage_deg", "reading_deg", "approach", "accel_y_g", "accel_z_g", "temperature_c")
    rows = [
        [f"{getattr(pose, name):.6g}" for name in names] + ["AS-0042", lot.mount, f"{lot.nominal_deg:.4f}"]
        for lot in lots
        for pose in lot.poses
    ]
    return "\n".join(",".join(row) for row in [[*names, "unit", "mount", "mount_deg"], *rows]) + "\n"


def _judged(workers: ProcessPoolExecutor, case: Case, seeds: range, share_s: float) -> list[Judged]:
    began, judged = time.monotonic(), []
    for first in range(0, len(seeds), BATCH):
        of_case = partial(judge, case, with_bound=case in BOUNDS.values())
        judged += workers.map(of_case, seeds[first : first + BATCH])
        if time.monotonic() - began > share_s:
            break
    return judged


def _beside_bound(name: str, case: Case, judged: list[Judged]) -> str:
    bound = math.sqrt(np.mean([j.bound_deg**2 for j in judged]))
    achieved, said = _rms(judged)
    stated = "" if case.issue_deg is None else f"{case.issue_deg:.4f}°"
    orders = np.mean([j.orders for j in judged])
    return (
        f"| {name} | {len(judged)} | {stated} | {bound:.4f}° | {achieved:.4f}° | {achieved / bound:.2f} | "
        f"{said:.4f}° | {orders:.1f} |\n"
    )


def _covered(name: str, judged: list[Judged]) -> str:
    achieved, said = _rms(judged)
    within = np.array([j.within_two for j in judged])
    error = within.std() / math.sqrt(len(within))
    return f"| {name} | {len(judged)} | {achieved:.4f}° | {said:.4f}° | {within.mean():.1%} | {error:.1%} |\n"


def _rms(judged: list[Judged]) -> tuple[float, float]:
    return (
        math.sqrt(np.mean([j.square_deg2 for j in judged])),
        math.sqrt(np.mean([j.stated_deg2 for j in judged])),
    )


if __name__ == "__main__":
    main()
