"""How long a comparison of 200 units with 20 runs each takes to come out of the store."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from calrig.store import Store
from calrig.store.tables import CalibrationTable, RunTable, UnitTable

UNITS, RUNS = 200, 20


@pytest.fixture
def store(tmp_path: Path):
    """4000 finished runs, put in by one transaction: 4000 of them would only measure the disk."""
    now = datetime.now(UTC)
    with Store.open(f"sqlite:///{tmp_path / 'calrig.db'}", writer="benchmark") as opened:
        with opened._database.writing() as session:
            session.add_all(UnitTable(serial=f"U{u:03}", created_at=now) for u in range(UNITS))
            session.flush()
            for number in range(1, UNITS * RUNS + 1):
                session.add(_run(number, now))
            session.flush()
            session.add_all(_figures(number) for number in range(1, UNITS * RUNS + 1))
        yield opened


def _run(number: int, now: datetime) -> RunTable:
    plan = {"kind": "calibration", "elevations_deg": [float(e) for e in range(-60, 61, 5)]}
    return RunTable(
        id=number,
        unit=f"U{number % UNITS:03}",
        rig="bench",
        kind="calibration",
        status="completed",
        plan=plan,
        progress={},
        result={"bias_deg": 0.1},
        faults={},
        provenance={"plan": plan},
        created_at=now,
        started_at=now,
        finished_at=now,
    )


def _figures(number: int) -> CalibrationTable:
    return CalibrationTable(
        run_id=number,
        bias_deg=0.1,
        bias_std_deg=0.01,
        scale=1.0,
        scale_std=0.001,
        rms_raw_deg=0.26,
        rms_calibrated_deg=0.05,
        rms_with_effects_deg=None,
        temperature_min_c=20.0,
        temperature_max_c=25.0,
    )


def test_comparison_query(benchmark, store):
    assert len(benchmark(store.comparison)) == UNITS * RUNS
