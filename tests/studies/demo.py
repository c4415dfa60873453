"""What a new user sees: the demo rig, diagnosed. `python -m tests.studies.demo [--runs N] [--first-seed S]`.

Each is the default plan on the demo rig's preset with a seed of its own, over its simulated ports, in virtual
time; it takes some eight seconds of a processor.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from empty_store import lay_empty_store
from support import known_as
from virtual_time import virtual_rig
from virtual_time.clock import VirtualClock

from calrig.calibration.diagnosis.tracing import diagnose
from calrig.calibration.poses import Pose
from calrig.plan import Plan
from calrig.runs.service import RunService
from calrig.simulator.config import SimulatorSettings
from calrig.store import Store

IN_IT = ("backlash", "accelerometer_offset", "temperature_offset", "stage_eccentricity")
"""What the demo rig has beside its bias; a gain of the gyro of 0.8 % is a fifth, near what its poses show."""
ALSO_TRUE = ("gyro_scale",)
LONGEST_S = 2000.0


def measured(seed: int, folder: Path, clock: VirtualClock) -> list[Pose]:
    """The poses of the default plan on a demo rig."""
    path = folder / f"{seed}.db"
    lay_empty_store(path)
    rig = virtual_rig(SimulatorSettings.from_options({"preset": "demo", "seed": seed}), clock)
    with rig, Store.open(f"sqlite:///{path}", writer="tests") as store:
        service = RunService(store, [known_as(f"demo-{seed}", rig)])
        run = service.start(unit="AS-0042", plan=Plan())
        clock.until(lambda: service.run(run.id).status not in ("queued", "running"), "end", LONGEST_S)
        ended = service.run(run.id)
        assert ended.status == "completed", ended.error
        poses = [stored.pose for stored in store.poses.of(run.id)]
        service.close()
    return poses


def judged(poses: list[Pose]) -> dict[str, Any]:
    """How many of the four are named alone, how many are in a set, and what else is named alone."""
    found = diagnose([poses], ["1"], cross_fit=False).findings.found
    alone = [f.candidate.name for f in found if f.verdict == "named"]
    possible = {c.name for f in found for c in (f.candidate, *f.rivals)}
    return {
        "alone": sum(name in alone for name in IN_IT),
        "held": sum(name in possible for name in IN_IT),
        "wrong": [name for name in alone if name not in (*IN_IT, *ALSO_TRUE)],
    }


def main() -> None:
    """Prints the counts."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.demo", description=__doc__)
    parser.add_argument("--runs", type=int, default=25)
    parser.add_argument("--first-seed", type=int, default=0)
    wanted = parser.parse_args()
    clock, results = VirtualClock(), []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(wanted.first_seed, wanted.first_seed + wanted.runs):
            results.append(judged(measured(seed, Path(folder), clock)))
            print(seed, results[-1], flush=True)  # noqa: T201
    alone = Counter(one["alone"] for one in results)
    print(f"all four named alone: {alone[4]} of {len(results)}; three: {alone[3]}")  # noqa: T201
    print(f"all four in a set: {sum(one['held'] == 4 for one in results)}")  # noqa: T201
    print(f"a wrong name: {sum(bool(one['wrong']) for one in results)}")  # noqa: T201


if __name__ == "__main__":
    main()
