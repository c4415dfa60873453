"""How long a comparison of 200 units with 20 runs each takes: out of the store, and as it is answered."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from pydantic_core import to_json
from sqlmodel import col, select

from calrig.analysis import histories
from calrig.analysis.comparison import compared_runs, comparison
from calrig.analysis.due_dates import due_dates
from calrig.calibration.uncertainty.conformity import Limit
from calrig.store import Store
from calrig.store.tables import CalibrationTable, RunTable, UnitTable

UNITS, RUNS, RIGS = 200, 20, 3
FIRST_DAY = datetime(2024, 1, 1, 8, tzinfo=UTC)


@pytest.fixture
def store(tmp_path: Path):
    """4000 finished runs on three rigs over two years, put in by one transaction for the disk's sake."""
    rng = np.random.default_rng(0)
    days = np.sort(rng.integers(0, 730, (RUNS, UNITS)), axis=0).ravel()
    with Store.open(f"sqlite:///{tmp_path / 'calrig.db'}", writer="benchmark") as opened:
        with opened._database.writing() as session:
            session.add_all(UnitTable(serial=f"U{u:03}", created_at=FIRST_DAY) for u in range(UNITS))
            session.flush()
            for number in range(1, UNITS * RUNS + 1):
                session.add(_run(number, FIRST_DAY + timedelta(days=int(days[number - 1]), seconds=number)))
            session.flush()
            session.add_all(_figures(number, rng) for number in range(1, UNITS * RUNS + 1))
        yield opened


def _run(number: int, at: datetime) -> RunTable:
    plan = {"kind": "calibration", "elevations_deg": [float(e) for e in range(-60, 61, 5)]}
    return RunTable(
        id=number,
        uid=str(number),
        unit=f"U{number % UNITS:03}",
        rig=f"bench-{number % UNITS % RIGS}",
        kind="calibration",
        status="completed",
        plan=plan,
        progress={},
        result={"bias_deg": 0.1},
        faults={},
        provenance={"plan": plan},
        created_at=at,
        started_at=at,
        finished_at=at,
    )


def _figures(number: int, rng: np.random.Generator) -> CalibrationTable:
    return CalibrationTable(
        run_id=number,
        bias_deg=0.1 * (number % UNITS) + 0.03 * rng.normal(),
        bias_std_deg=0.01,
        scale=1.0 + 0.001 * rng.normal(),
        scale_std=0.0003,
        rms_raw_deg=0.26,
        rms_calibrated_deg=0.05,
        rms_with_effects_deg=None,
        temperature_min_c=20.0,
        temperature_max_c=25.0,
    )


def test_comparison_query(benchmark, store):
    assert len(benchmark(store.units.comparison)) == UNITS * RUNS


def test_comparison_with_changes_and_due_dates(benchmark, store):
    """As `GET /api/compare` answers for a store it has not seen yet: aim 300 ms."""
    limit = Limit(name="all", bias_deg=(-1.0, 30.0), scale=(0.98, 1.02))

    def answer() -> bytes:
        histories._changes.cache_clear()
        found = histories.histories(store)
        due = due_dates(store, found, limits=[limit])
        return to_json(comparison(found, compared_runs(store, None, found), due, {}), inf_nan_mode="null")

    assert len(benchmark(answer)) > 100_000


def test_what_stages_are_worth_is_read_without_the_rest_of_the_results(store):
    """As where units move between rigs: a page of one unit asks it of thousands of runs."""
    stated = {"std_deg": 0.01, "bias_std_deg": 0.006, "scale_std": 0.0001}
    elevations = [dict.fromkeys(("elevation_deg", "raw_deg", "std_deg", "n"), k / 7) for k in range(73)]
    with store._database.writing() as session:
        for run in session.exec(select(RunTable).limit(1_000)):
            run.result = {**run.result, "reference": stated, "per_elevation": elevations}
    ids = [str(number) for number in range(1, 1_001)]

    def took_s(read: Callable[[], object]) -> float:
        began = time.process_time()
        read()
        return time.process_time() - began

    with store._database.reading() as session:
        wanted = select(RunTable.result).where(col(RunTable.uid).in_(ids))
        whole_s = min(took_s(lambda: session.exec(wanted).all()) for _ in range(3))
    part_s = min(took_s(lambda: store.runs.reference_figures(ids)) for _ in range(3))
    assert len(store.runs.reference_figures(ids)) == len(ids)
    assert part_s < whole_s / 3.0
