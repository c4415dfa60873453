"""Tries what calrig must withstand and prints the counts: `python -m tests.studies.trials [NAME[=SHARE]…]`.

Exit status 1 where a promise is not kept. Without a share all that is promised
is tried; `.ci/run` tries a share of each.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time

from rich.console import Console
from rich.table import Table

from tests.studies.trials.counting import Count, Extent, Trial

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # inherited by the workers, who load numpy anew: one core each

NAMES = ("kills", "faults", "requests", "imports", "load", "stop", "benches", "cuts", "amendments", "upgrade")
"""Modules beside this one, each with a `trial`."""


def main() -> int:
    """Runs the trials that are asked for."""
    ask = argparse.ArgumentParser(prog="python -m tests.studies.trials", description=__doc__)
    ask.add_argument("names", nargs="*", metavar="NAME[=SHARE]", help=f"of {', '.join(NAMES)}; without: all")
    ask.add_argument("--share", type=float, default=1.0, help="of the promised numbers, where none is named")
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    asked = ask.parse_args()
    shares: dict[str, float] = {}
    for named in asked.names or NAMES:
        name, _, share = named.partition("=")
        if name not in NAMES:
            ask.error(f"there is no trial {name}")
        try:
            shares[name] = float(share or asked.share)
        except ValueError:
            ask.error(f"{named}: the share is no number")
    console, missed = Console(), list[str]()
    for name, share_of_it in shares.items():
        trial: Trial = importlib.import_module(f"tests.studies.trials.{name}").trial
        began_s = time.monotonic()
        counts = trial(Extent(share_of_it, asked.seed, asked.workers))
        _print(console, f"{name}, {time.monotonic() - began_s:.0f} s", counts)
        missed += [
            f"{name}: {count.what}: {count.counted}; aim: {count.aim}" for count in counts if not count.kept
        ]
    for line in missed:  # last, so that nobody has to look for it in the tables
        console.print(f"MISSED {line}", highlight=False, markup=False)
    return 1 if missed else 0


def _print(console: Console, title: str, counts: list[Count]) -> None:
    table = Table("", "tried", "aim", "counted", title=title, title_justify="left")
    for count in counts:
        table.add_row(count.what, count.tried, count.aim, count.counted + ("" if count.kept else " MISSED"))
    console.print(table)
    for count in counts:
        for note in count.notes[:20]:
            console.print(f"  {count.what}: {note}", highlight=False, markup=False)


if __name__ == "__main__":
    sys.exit(main())
