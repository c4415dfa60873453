"""Tries what calrig must withstand and prints the counts: `python -m tests.trials [NAME…] [--share 0.1]`.

Exit status 1 where a promise is not kept. `.ci/run` runs a tenth.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time

from rich.console import Console
from rich.table import Table

from tests.trials.counting import Count, Extent, Trial

NAMES = ("kills", "faults", "requests", "imports", "load")
"""Modules beside this one, each with a `trial`."""


def main() -> int:
    """Runs the trials that are asked for."""
    ask = argparse.ArgumentParser(prog="python -m tests.trials", description=__doc__)
    ask.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}; without: all")
    ask.add_argument("--share", type=float, default=1.0, help="of the promised numbers")
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    asked = ask.parse_args()
    if unknown := set(asked.names) - set(NAMES):
        ask.error(f"there is no trial {', '.join(sorted(unknown))}")
    extent = Extent(asked.share, asked.seed, asked.workers)
    console, kept = Console(), True
    for name in asked.names or NAMES:
        trial: Trial = importlib.import_module(f"tests.trials.{name}").trial
        began_s = time.monotonic()
        counts = trial(extent)
        _print(console, f"{name}, {time.monotonic() - began_s:.0f} s", counts)
        kept &= all(count.kept for count in counts)
    return 0 if kept else 1


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
