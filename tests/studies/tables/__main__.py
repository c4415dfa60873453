"""Diagnose generated tables, counting how they end: `python -m tests.studies.tables [--tables 20000]`.

With `--commands` the tables are files, read by the commands and the HTTP API, and every answer is checked.
Some 0.35 s of processor time a table. Exits with 1 where one ended in neither an answer nor a refusal.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

from calrig.calibration.poses import DiagnosisError
from tests.support import running_service, serving

from .commands import Bench, case
from .generate import diagnosed


def main() -> int:
    """Print the count of each outcome, and a table's number with the error that it ended in."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.tables", description=__doc__)
    parser.add_argument("--tables", type=int, default=20_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first table")
    parser.add_argument("--bootstraps", type=int, default=99, help="of each step of the search")
    parser.add_argument("--commands", action="store_true", help="as files, through commands and API")
    asked = parser.parse_args()
    counts: Counter[str] = Counter()
    warnings.simplefilter("ignore")
    began_s = time.process_time()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        bench: Bench | None = None
        if asked.commands:
            service = stack.enter_context(running_service(folder / "api.db"))
            client = stack.enter_context(serving(service))
            bench = Bench(folder, client, asked.bootstraps)
        for number in range(asked.first, asked.first + asked.tables):
            before_s = time.process_time()
            what, ended = _ended(number, bench, asked.bootstraps)
            counts[f"{what} {ended}"] += 1
            if (spent_s := time.process_time() - before_s) > 30.0:
                _say(f"table {number}: {what} took {spent_s:.0f} s")
            if number % 200 == 199:
                _say(f"{number}: {_told(counts)}; {time.process_time() - began_s:.0f} s")
    _say(_told(counts))
    return 1 if any(what.endswith("error") for what in counts) else 0


def _ended(number: int, bench: Bench | None, bootstraps: int) -> tuple[str, str]:
    """Return what a table went through, and its verdict, `refused` or `error`."""
    what = "poses"
    try:
        if bench is None:
            return what, str(diagnosed(number, bootstraps)["verdict"])
        one = case(number)
        what = one.command
        return what, bench.outcome(one)
    except DiagnosisError:
        return what, "refused"
    except Exception as error:  # noqa: BLE001 (it is what is counted)
        last = traceback.extract_tb(error.__traceback__)[-1]
        told = str(error).replace("\n", " ")[:400]
        _say(f"table {number} ({what}): {type(error).__name__} in {last.name}: {told}")
        return what, "error"


def _told(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {what}" for what, count in sorted(counts.items()))


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
