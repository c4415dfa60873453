"""How long 20,000 runs are looked through for a verdict that none has: of 10⁵, a fifth, which is one page."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.calibration.uncertainty.budget import Reference
from calrig.calibration.uncertainty.conformity import Limit
from calrig.store import Store
from calrig.store.runs import Sought
from calrig.store.tables import RunTable, UnitTable

UNITS, RUNS = 2_000, 20_000
FIRST_DAY = datetime(2024, 1, 1, 8, tzinfo=UTC)
LIMITS = [
    Limit(name="flight", units="U0*", max_error_deg=0.5, rule="guarded"),
    Limit(name="all", scale=(0.9, 1.1), rms_deg=0.5, rule="guarded"),
]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory):
    path: Path = tmp_path_factory.mktemp("judged") / "calrig.db"
    noise = np.random.default_rng(0)
    theta_deg = np.tile(np.arange(-60.0, 61.0, 10.0), 4)
    reading_deg = 0.8 + 1.002 * theta_deg + noise.normal(0.0, 0.02, len(theta_deg))
    poses = [
        Pose(target_deg=float(a), reading_deg=float(r), reading_stderr_deg=0.02)
        for a, r in zip(theta_deg, reading_deg, strict=True)
    ]
    result = build_result(poses, None, (), Reference(0.03, distribution="normal")).to_dict()
    with Store.open(f"sqlite:///{path}", writer="benchmark") as opened:
        opened.limits.replace(LIMITS, who=None)
        with opened._database.writing() as session:
            session.add_all(UnitTable(serial=f"U{u:04}", created_at=FIRST_DAY) for u in range(UNITS))
            session.flush()
            session.add_all(_run(number, result) for number in range(1, RUNS + 1))
        yield opened


def _run(number: int, result: dict) -> RunTable:
    at = FIRST_DAY + timedelta(minutes=7 * number)
    return RunTable(
        id=number,
        uid=str(number),
        unit=f"U{number % UNITS:04}",
        rig=f"bench-{number % 3}",
        kind="calibration",
        status="completed",
        plan={"kind": "calibration"},
        progress={},
        result=result | {"bias_deg": number / RUNS},
        faults={},
        provenance={},
        created_at=at,
        started_at=at,
        finished_at=at,
    )


@pytest.mark.parametrize("judged", ["fail", "more_than_noise"])
def test_a_verdict_that_no_run_has(benchmark, store, judged):
    """Aim 0.3 s."""
    found = benchmark(store.verdicts.judged_runs, Sought(), judged)
    assert (found.items, found.judged_whole, found.next_cursor) == ([], [], None)
