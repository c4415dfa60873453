"""1,000 runs over damaged wires: `python -m tests.studies.trials faults`.

One of them alone, by the name it is counted under: `python -m tests.studies.trials.faults 1-17`.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

from virtual_time.clock import VirtualClock

from calrig.store import Store

from .counting import Count, Extent, none_of
from .faults_run import Case, Outcome, try_case
from .proxy_damage import TO_DEVICE, TO_HOST, Fault

RUNS = 1000
STAGES = ("smc100", "grbl", "esp301", "zaber")
SKETCH = "i2cdev-raw-fast"
SKETCH_EVERY = 40
SHOWN_BY_TEXT = ("lose line", "nul", "delay", "cut", "stall", "mute", "gone", "returns", "renamed", "freeze")
"""Kinds that lines without checksum, sequence or clock can show; another digit is a digit."""
BYTES, LINES = ("flip", "lose", "stutter"), ("lose line", "double line", "noise", "nul", "xoff")
PAUSES = ("delay", "cut")
BOTH = (TO_DEVICE, TO_HOST)
RATES = {
    ("stage", BYTES, BOTH): (0.001, 0.01, 0.05),
    ("stage", LINES, BOTH): (0.01, 0.05, 0.2),
    ("stage", PAUSES, BOTH): (0.01, 0.05, 0.2),
    ("stage", ("late", "echo"), (TO_HOST,)): (0.01, 0.05, 0.2),
    ("stage", ("stall", "mute"), BOTH): (0.2, 1.0, 3.0, 6.0),
    ("stage", ("gone", "returns", "renamed", "reset"), (TO_HOST,)): (0.1, 0.5, 1.5),
    ("board", BYTES, (TO_HOST,)): (0.0001, 0.001, 0.01),
    ("board", LINES, (TO_HOST,)): (0.001, 0.01, 0.1),
    ("board", PAUSES, (TO_HOST,)): (0.0001, 0.0003, 0.001),
    ("board", (*BYTES, *LINES, *PAUSES), (TO_DEVICE,)): (0.1, 0.3),
    ("board", ("stall", "mute"), (TO_HOST,)): (0.2, 1.0, 3.0, 6.0),
    ("board", ("gone", "returns", "renamed", "reset", "freeze"), (TO_HOST,)): (0.1, 0.5, 1.5),
}
"""Of each wire, kinds and directions: how often, a byte or line or packet; or how long, in s."""
LATEST_S = 1.5
"""A run is over in two."""

WAYS = [
    (wire, kind, direction, sizes)
    for (wire, kinds, directions), sizes in RATES.items()
    for kind in kinds
    for direction in directions
]


def cases(seed: int) -> Iterator[Case]:
    """Case after case, every way of damage in turn, on every dialect; the same for the same seed."""
    chance = random.Random(seed)
    number = 0
    while True:
        for wire, kind, direction, sizes in chance.sample(WAYS, len(WAYS)):
            may_be_text = wire == "board" and direction == TO_HOST and kind in SHOWN_BY_TEXT
            begins_s = chance.choice((0.0, chance.uniform(0.0, LATEST_S)))
            yield Case(
                name=f"{seed}-{number}",
                stage=chance.choice(STAGES),
                wire=wire,
                fault=Fault(kind, direction, chance.choice(sizes), begins_s),
                seed=chance.randrange(1 << 31),
                sketch=SKETCH if may_be_text and number % SKETCH_EVERY < 4 else None,
            )
            number += 1


def trial(extent: Extent) -> list[Count]:
    """Runs a share of 1,000 over damaged wires and counts what may not be."""
    outcomes = try_all(list(islice(cases(extent.seed), extent.of(RUNS))), extent.workers)
    statuses = Counter(outcome.status for outcome in outcomes)
    tried = f"{len(outcomes):,} runs ({', '.join(f'{n} {status}' for status, n in sorted(statuses.items()))})"
    warned = sum(outcome.honest for outcome in outcomes)
    promised = {
        "wrong readings": "wrong",
        "runs without a reason": "without_reason",
        "stage left moving": "left_moving",
        "hung": "hung",
        "damage that no counter shows": "uncounted",
        "commands beyond the soft limits": "beyond",
    }
    counts = [
        none_of(what, tried, [f"{o.case}: {line}" for o in outcomes for line in getattr(o, name)])
        for what, name in promised.items()
    ]
    said = Count(
        "stage out of reach, and the run says: cut its motor power", tried, "said", str(warned), True
    )
    return [*counts, said]


def try_all(chosen: list[Case], workers: int) -> list[Outcome]:
    """Tries cases in processes of their own, two a worker: a run waits most of its time."""
    with ProcessPoolExecutor(2 * workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(try_one, chosen))


def try_one(case: Case) -> Outcome:
    """One case, in a store of its own: over terminals, and a board without a clock in virtual time.

    Its lines have the time at which they are heard, so that a busy machine would be in its readings. A Zaber
    stage's library cannot be given time.
    """
    virtual = VirtualClock() if case.sketch is not None and case.stage != "zaber" else None
    with tempfile.TemporaryDirectory() as folder, nullcontext() if virtual is None else virtual.taking_part():
        path = Path(folder)
        with Store.open(f"sqlite:///{path / 'calrig.db'}", writer="trial") as store:
            return try_case(case, store, path, virtual)


def _alone(name: str) -> None:
    seed, number = map(int, name.split("-"))
    outcome = try_one(next(islice(cases(seed), number, None)))
    for key, value in vars(outcome).items():
        print(f"{key}: {value}")  # noqa: T201 (what was asked for)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        _alone(name)
