"""What a user waits for, and what a running rig costs: reported, never asserted.

`python -m pytest tests/benchmarks/test_startup.py`
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import httpx
import psutil
from sqlmodel import insert
from support import running_service, serving

from calrig.store.sqlite.database import SqliteDatabase
from calrig.store.tables import CalibrationTable, RunTable, UnitTable

CALRIG = (sys.executable, "-m", "calrig")
UNITS, RUNS_A_UNIT = 200, 20
CONFIG = '[[rig]]\nname = "bench-1"\nsimulated = { preset = "demo", time_scale = 1.0 }\n'


@contextmanager
def serve(folder) -> Iterator[tuple[psutil.Process, str]]:
    """`calrig serve` once it is ready: the process and its address."""
    command = [*CALRIG, "serve", "--port", "0", "--db", str(folder / "calrig.db")]
    process = psutil.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        yield process, next(word for word in process.stdout.readline().split() if "://" in word).rstrip(",")
    finally:
        process.terminate()
        process.communicate(timeout=10)


def test_help(benchmark):
    """Aim: 0.4 s."""
    benchmark.pedantic(
        lambda: subprocess.run([*CALRIG, "--help"], check=True, capture_output=True),
        rounds=5,
        warmup_rounds=1,
    )


def test_service_start_up_to_ready(benchmark, tmp_path):
    """Until the line that says so, on an existing store, the simulated rig included. Aim: 2 s."""
    running = []

    def start() -> None:
        service = serve(tmp_path)
        running.append(service)
        service.__enter__()

    def stop() -> None:
        while running:
            running.pop().__exit__(None, None, None)

    benchmark.pedantic(start, setup=stop, rounds=4, warmup_rounds=1)
    stop()


def fill(path) -> None:
    """Two hundred units with twenty completed calibrations each."""
    start = datetime(2026, 1, 1, tzinfo=UTC)
    units = [f"AS-{k:04d}" for k in range(UNITS)]
    runs = [(unit, start + timedelta(hours=k)) for unit in units for k in range(RUNS_A_UNIT)]
    document = {"seed": 1, "elevations_deg": list(range(100)), "words": "x" * 1000}
    database = SqliteDatabase(path, "benchmark", 10.0)
    with database.writing() as session:
        session.execute(insert(UnitTable), [{"serial": unit, "created_at": start} for unit in units])
        session.execute(
            insert(RunTable),
            [
                {
                    "id": number,
                    "uid": str(number),
                    "unit": unit,
                    "rig": "bench-1",
                    "kind": "calibration",
                    "status": "completed",
                    "plan": document,
                    "progress": {},
                    "result": document,
                    "faults": {},
                    "provenance": document,
                    "created_at": when,
                    "finished_at": when,
                }
                for number, (unit, when) in enumerate(runs, start=1)
            ],
        )
        session.execute(
            insert(CalibrationTable),
            [
                {
                    "run_id": number,
                    "bias_deg": 0.8 + number * 1e-5,
                    "bias_std_deg": 0.01,
                    "scale": 1.0,
                    "scale_std": 1e-4,
                    "rms_raw_deg": 0.26,
                    "rms_calibrated_deg": 0.05,
                    "temperature_min_c": 20.0,
                    "temperature_max_c": 30.0,
                }
                for number in range(1, len(runs) + 1)
            ],
        )
    database.close()


def test_comparison_of_200_units_with_20_runs_each(benchmark, tmp_path, rig):
    """Over HTTP, the answer read. Aim: 150 ms."""
    fill(tmp_path / "calrig.db")
    with running_service(tmp_path / "calrig.db", rig) as service, serving(service) as client:
        answer = benchmark.pedantic(
            lambda: client.get("/api/compare").raise_for_status(), rounds=10, warmup_rounds=1
        )
    assert sum(len(unit["runs"]) for unit in answer.json()["units"]) == UNITS * RUNS_A_UNIT


def test_processor_share_of_one_rig_at_200_hz_in_real_time(tmp_path, capsys):
    """The service's own process, filter, store and a watching browser included. Aim: 5 % of a core."""
    (tmp_path / "calrig.toml").write_text(CONFIG)
    plan = {"elevations_deg": [-10, 10], "sweeps": 10, "dwell_s": 2.0}
    with serve(tmp_path) as (process, url), httpx.Client(base_url=url, timeout=30) as client:
        run_id = client.post("/api/runs", json={"unit": "A", "plan": plan}).json()["id"]
        with client.stream("GET", f"/api/runs/{run_id}/events") as events:
            lines = events.iter_lines()
            _skip_to(lines, "pose")
            share = _processor_share(process, lines, seconds=20)
        client.post(f"/api/runs/{run_id}/abort")
    with capsys.disabled():
        sys.stdout.write(f"\none rig at 200 Hz in real time: {100 * share:.1f} % of a core\n")


def _skip_to(lines: Iterator[str], kind: str) -> None:
    next(line for line in lines if line == f"event: {kind}")


def _processor_share(process: psutil.Process, lines: Iterator[str], seconds: float) -> float:
    """Processor time over time of a process, measured while the events of its run are read."""
    first, began = process.cpu_times(), datetime.now(UTC)
    for _ in lines:
        took_s = (datetime.now(UTC) - began).total_seconds()
        if took_s >= seconds:
            break
    last = process.cpu_times()
    return (last.user + last.system - first.user - first.system) / took_s
