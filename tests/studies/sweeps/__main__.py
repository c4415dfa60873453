"""Print the table of docs/validation/sweeps.md.

`python -m tests.studies.sweeps --runs 40`; some 6 s of a core a run.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np

from tests.studies.sweeps.rigs import BIAS_DEG, CASES, SHAKING, Swept, swept


def main() -> None:
    """Prints both tables."""
    asked = argparse.ArgumentParser(prog="python -m tests.studies.sweeps", description=__doc__)
    asked.add_argument("--runs", type=int, default=40, help="of each case")
    asked.add_argument("--first-seed", type=int, default=0)
    asked.add_argument("--processes", type=int, default=2)
    given = asked.parse_args()
    fresh = count(given.first_seed)  # so that no row rests on the noise of another
    seeds = partial(islice, fresh, given.runs)
    with ProcessPoolExecutor(given.processes) as pool:
        _say(
            "rig",
            "completed",
            "bias: mean error",
            "RMS",
            "within two",
            "scale: RMS error",
            "within two",
            "up less down",
        )
        _say(*["---"] * 8)
        for name, options in CASES.items():
            _say(name, *_steady(list(pool.map(partial(_one, options), seeds()))))
        sys.stdout.write("\n")
        _say("motor shakes with", "refused", "completed: RMS bias of stretches", "the largest")
        _say(*["---"] * 4)
        for name, options in SHAKING.items():
            _say(name, *_shaken(list(pool.map(partial(_one, options), seeds()))))


def _say(*cells: str) -> None:
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


def _one(options: Mapping[str, Any], seed: int) -> Swept:
    logging.disable()
    with tempfile.TemporaryDirectory() as folder:
        return swept(options, seed, Path(folder))


def _steady(runs: list[Swept]) -> list[str]:
    results = [one.run.result for one in runs if one.run.result is not None]
    bias = np.array([(r.bias_deg - BIAS_DEG, r.bias_std_deg) for r in results])
    scale = np.array([(r.scale - 1.0, r.scale_std) for r in results])
    sense = np.array([one.sense_error_deg for one in runs if one.run.result is not None])
    return [
        f"{len(results)} of {len(runs)}",
        f"{bias[:, 0].mean():+.4f}° ± {bias[:, 0].std(ddof=1) / math.sqrt(len(bias)):.4f}°",
        f"{_rms(bias[:, 0]):.4f}°",
        _within(bias),
        f"{_rms(scale[:, 0]):.1e}",
        _within(scale),
        f"{sense.mean():+.4f}° ± {sense.std():.4f}°",
    ]


def _shaken(runs: list[Swept]) -> list[str]:
    kept = [one for one in runs if one.run.status == "completed"]
    bias = np.array([one.errors_deg[one.senses != 0].mean() for one in kept])
    left = [f"{_rms(bias):.4f}°", f"{np.abs(bias).max():.4f}°"] if kept else ["–", "–"]
    return [f"{len(runs) - len(kept)} of {len(runs)}", *left]


def _within(pairs: np.ndarray) -> str:
    return f"{100.0 * np.mean(np.abs(pairs[:, 0]) <= 2.0 * pairs[:, 1]):.0f} %"


def _rms(values: np.ndarray) -> float:
    return math.sqrt(float(np.mean(values**2)))


if __name__ == "__main__":
    main()
