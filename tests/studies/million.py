"""A centre with a million runs: how long its pages take, `python -m tests.studies.million [--runs N]`.

The runs are calibrations of poses by the simulator's physics, twenty a unit, laid into a real PostgreSQL
server; the times are those of whole requests over HTTP.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
from sqlalchemy import make_url

from calrig.calibration.results.result import build_result
from calrig.plan import Plan
from calrig.store.checksums import of_numbers, sealed, to_json
from calrig.store.convert import FIGURES, figures_of
from studies.blind.cells import backlash, bias_tempco
from studies.blind.physics import Noise, measure, timeline
from tests.studies.trials.centre import centre

RUNS, A_UNIT, DRAWN = 1_000_000, 20, 200
TRIES = 20
FIRST = datetime(2016, 1, 1, tzinfo=UTC)
APART = timedelta(minutes=5)


def _results() -> list[dict[str, Any]]:
    """Results of runs with a play and a warm-up of their own."""
    rng, plan = np.random.default_rng(1), Plan()
    found = []
    for _ in range(DRAWN):
        draws = backlash(rng.uniform(0.02, 0.2)), bias_tempco(rng.uniform(0.0, 0.02))
        causes = [draw(rng, timeline(plan)) for draw in draws]
        found.append(build_result(measure(plan, causes, Noise(), rng).poses).to_dict())
    return found


def _text(at: datetime) -> str:
    return at.isoformat(timespec="microseconds")


def lay(url: str, runs: int) -> None:
    """Lays units, runs and their figures into an empty store, past its methods: a million takes a minute."""
    results = _results()
    documents = [to_json(sealed(result)) for result in results]
    plan, empty = to_json(sealed(Plan().model_dump(mode="json"))), to_json(sealed({}))
    done = to_json(sealed({"poses_done": 52, "poses_total": 52, "fraction": 1.0, "remaining_s": 0.0}))
    units = -(-runs // A_UNIT)

    def of_runs() -> Iterator[tuple[Any, ...]]:
        for k in range(runs):
            at = _text(FIRST + k * APART)
            unit, rig = f"AS-{k % units:06}", f"bench-{k % 40}"
            yield (
                k + 1,
                str(uuid.uuid4()),
                unit,
                rig,
                "calibration",
                "completed",
                plan,
                done,
                documents[k % DRAWN],
                empty,
                empty,
                at,
                at,
                at,
            )

    def of_figures() -> Iterator[tuple[Any, ...]]:
        for k in range(runs):
            row = figures_of(k + 1, results[k % DRAWN])
            numbers = [getattr(row, name) for name in FIGURES]
            yield k + 1, *numbers, of_numbers(numbers)

    driven = make_url(url).set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(driven) as connection, connection.cursor() as cursor:
        for table, columns, rows in (
            ("unit", "serial, created_at", ((f"AS-{k:06}", _text(FIRST)) for k in range(units))),
            (
                "run",
                "id, uid, unit, rig, kind, status, plan, progress, result, faults, provenance, created_at, "
                "started_at, finished_at",
                of_runs(),
            ),
            ("calibration", f"run_id, {', '.join(FIGURES)}, crc32", of_figures()),
        ):
            with cursor.copy(f"COPY {table} ({columns}) FROM STDIN") as copy:
                for row in rows:
                    copy.write_row(row)
        cursor.execute("SELECT setval(pg_get_serial_sequence('run', 'id'), max(id)) FROM run")
    with psycopg.connect(driven, autocommit=True) as connection:
        connection.execute("ANALYZE")


def main() -> None:
    """Lays the runs, asks, prints."""
    ask = argparse.ArgumentParser(prog="python -m tests.studies.million", description=__doc__)
    ask.add_argument("--runs", type=int, default=RUNS)
    runs = ask.parse_args().runs
    with tempfile.TemporaryDirectory() as name, centre(Path(name)) as at:  # nothing there to bring over
        began_s = time.monotonic()
        lay(at.server.url, runs)
        sys.stdout.write(f"{runs} runs laid in {time.monotonic() - began_s:.0f} s\n")
        client = at.served[0].client
        middle = runs // A_UNIT // 2
        compared = "&".join(f"unit=AS-{k:06}" for k in range(middle, middle + 200))
        page = client.get("/api/runs?limit=50").json()
        for what, path in {
            "run list, first page of 50": "/api/runs?limit=50",
            "run list, next page": f"/api/runs?limit=50&cursor={page['next_cursor']}",
            "run list of one rig": "/api/runs?limit=50&rig=bench-7",
            "run list, failed": "/api/runs?limit=50&status=failed",
            "a unit with its runs": f"/api/units/AS-{middle:06}",
            "its changes": f"/api/units/AS-{middle:06}/changes",
            "comparison of 200 units": f"/api/compare?{compared}",
            "metrics": "/api/metrics",
        }.items():
            took_ms = []
            for _ in range(TRIES):
                began_s = time.monotonic()
                client.get(path).raise_for_status()
                took_ms.append(1000 * (time.monotonic() - began_s))
            sys.stdout.write(
                f"{what}: first {took_ms[0]:.0f} ms, median {statistics.median(took_ms):.0f} ms, "
                f"longest after it {max(took_ms[1:]):.0f} ms\n"
            )


if __name__ == "__main__":
    main()
