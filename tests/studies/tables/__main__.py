"""Diagnose generated tables, counting answers and errors: `python -m tests.studies.tables [--tables 20000]`.

Some 3 s of processor time a table. Exits with 1 where one ended otherwise than with an answer or a refusal.
"""

from __future__ import annotations

import argparse
import sys
import traceback
import warnings
from collections import Counter

from calrig.calibration.poses import DiagnosisError

from .generate import diagnosed


def main() -> int:
    """Prints the count of each verdict, and a table's number with the error that it ended in."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.tables", description=__doc__)
    parser.add_argument("--tables", type=int, default=20_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first table")
    parser.add_argument("--bootstraps", type=int, default=999, help="of each step of the search")
    asked = parser.parse_args()
    counts: Counter[str] = Counter()
    warnings.simplefilter("ignore")
    for number in range(asked.first, asked.first + asked.tables):
        try:
            counts[diagnosed(number, asked.bootstraps)["verdict"]] += 1
        except DiagnosisError:
            counts["refused"] += 1
        except Exception as error:  # noqa: BLE001 (it is what is counted)
            counts["error"] += 1
            last = traceback.extract_tb(error.__traceback__)[-1]
            _say(f"table {number}: {type(error).__name__} in {last.name}: {error}")
    _say(", ".join(f"{count} {verdict}" for verdict, count in counts.most_common()))
    return 1 if counts["error"] else 0


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
