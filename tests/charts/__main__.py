"""The table of docs/validation/control-charts.md: `python -m tests.charts [--seeds 20000]`."""

from __future__ import annotations

import argparse
import sys

from .rates import EARLIER, FREEDOM, LATER, STDS, detected, false_alarms, individuals, pooled_from, unit_chart


def main() -> None:
    """Prints it."""
    parser = argparse.ArgumentParser(prog="python -m tests.charts", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20_000)
    seeds = parser.parse_args().seeds
    _say(f"| earlier runs | {' | '.join(map(str, EARLIER))} |")
    _say(f"| --- {'| --- ' * len(EARLIER)}|")
    for name, std in STDS.items():
        rates = [false_alarms(unit_chart, n, std(n + LATER), seeds) for n in EARLIER]
        _row(f"false alarms within {LATER} further runs, uncertainties {name}", rates)
    for freedom in FREEDOM:
        rates = [false_alarms(pooled_from(freedom), n, STDS["equal"](n + LATER), seeds) for n in EARLIER]
        _row(f"the same, equal, spread pooled from {freedom} repeats", rates)
    _row("the same, I-MR with limits from the earlier runs, equal",
         [false_alarms(individuals, n, STDS["equal"](n + LATER), seeds) for n in EARLIER])  # fmt: skip
    _row("a shift of 2σ is detected within 4 runs", [detected(unit_chart, n, seeds) for n in EARLIER])


def _row(name: str, rates: list[float]) -> None:
    _say(f"| {name} | {' | '.join(f'{100 * rate:.1f} %' for rate in rates)} |")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()
