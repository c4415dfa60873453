"""Files of poses and logs, damaged in every way there is: each is read whole, or refused where it is wrong.

What a file holds is told by an oracle of its own: Python's csv module and `float`.
"""

from __future__ import annotations

import json
import multiprocessing
import random
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from calrig.analysis.amendments import Records
from calrig.analysis.errors import Invalid
from calrig.calibration.poses import Pose
from calrig.calibration.results.result import build_result
from calrig.export.csv_errors import CsvError
from calrig.export.poses_csv import read_poses, write_poses
from calrig.export.static_csv import read_static
from calrig.store import Store
from tests.studies.trials.counting import Count, Extent, none_of
from tests.studies.trials.damaged_csv import LOG_COLUMNS, damaged_log, damaged_poses, rows_of

FILES = 100_000
LOGS = 5
"""One file in so many is a log."""
STORED = 20
"""One file of poses in so many goes the whole way, into a store and out of it again."""
WITHOUT_A_LINE = (
    "the file is empty",
    "the file has comments and no rows",
    "the file has a header and no rows",
    "at most",
)
A_PIECE = 1000


def trial(extent: Extent) -> list[Count]:
    """Reads them on all processors."""
    n = extent.of(FILES)
    tasks = [(extent.seed, first, min(first + A_PIECE, n)) for first in range(0, n, A_PIECE)]
    outcomes: Counter[str] = Counter()
    failures: dict[str, list[str]] = {"crash": [], "lost": [], "nowhere": []}
    # Spawned: a fork would take over threads and open stores of whoever asks.
    with ProcessPoolExecutor(extent.workers, multiprocessing.get_context("spawn")) as pool:
        for counted, failed in pool.map(_tried, tasks):
            outcomes.update(counted)
            for kind, line in failed:
                failures[kind].append(line)
    tried = f"{n:,} files: " + ", ".join(f"{count:,} {what}" for what, count in sorted(outcomes.items()))
    taken = sum(count for what, count in outcomes.items() if what.endswith("taken"))
    return [
        none_of("crashes of an import", tried, failures["crash"]),
        none_of("rows lost or values changed silently", f"{taken:,} files taken", failures["lost"]),
        none_of("refusals that do not say where", f"{n - taken:,} files refused", failures["nowhere"]),
    ]


def _tried(task: tuple[int, int, int]) -> tuple[Counter[str], list[tuple[str, str]]]:
    seed, first, end = task
    outcomes: Counter[str] = Counter()
    failed: list[tuple[str, str]] = []
    with TemporaryDirectory() as folder, Store.open(f"sqlite:///{folder}/trial.db", writer="trial") as store:
        for k in range(first, end):
            rng = random.Random(f"{seed} {k}")
            is_log = k % LOGS == 0
            data = (damaged_log if is_log else damaged_poses)(rng)
            try:
                wrong = _log(data) if is_log else _poses(data, store if k % STORED == 1 else None)
            except (CsvError, Invalid) as error:
                outcomes["logs refused" if is_log else "poses refused"] += 1
                if "line " not in str(error) and not any(words in str(error) for words in WITHOUT_A_LINE):
                    failed.append(("nowhere", f"file {k}: {error}"))
                continue
            except Exception as error:  # noqa: BLE001 (which is what is counted)
                failed.append(("crash", f"file {k}: {type(error).__name__}: {error}"))
                outcomes["crashed"] += 1
                continue
            outcomes["logs taken" if is_log else "poses taken"] += 1
            if wrong:
                failed.append(("lost", f"file {k}: {wrong}"))
    return outcomes, failed


def _poses(data: bytes, store: Store | None) -> str:
    """What is wrong with the poses that were read; empty if nothing."""
    imported = read_poses(data)
    wrong = _differences(data, imported.poses, imported.warnings)
    json.dumps(build_result(imported.poses).to_dict(), allow_nan=False)
    if store is None or wrong:
        return wrong
    run = Records(store).import_poses(unit="A", rig=None, file_name=Path("f.csv").name, content=data)
    kept = [stored.pose for stored in store.poses.of(run.id)]
    if kept != imported.poses:
        return "the store holds other poses than were read"
    again = read_poses(write_poses(kept).encode())
    return "" if _values(again.poses) == _values(kept) else "what was exported reads back as other poses"


def _values(poses: list[Pose]) -> list[dict[str, float | int]]:
    return [{name: value for name, value in pose.row().items() if value is not None} for pose in poses]


def _told(data: bytes, warnings: Sequence[str]) -> tuple[list[str], list[list[float | str | None]]]:
    """The header, and the rows less those that the reader says are comments, or before the header."""
    header, rows = rows_of(data)
    if any(warning.startswith("what comes before the names") for warning in warnings):
        is_of_log = not any("reading_deg" in row for row in rows)
        wanted = LOG_COLUMNS if is_of_log else ("target_deg", "reading_deg")
        k = next(
            k for k, row in enumerate(rows) if (any if is_of_log else all)(name in row for name in wanted)
        )
        header, rows = [str(name) for name in rows[k]], rows[k + 1 :]
    if any(warning.startswith("comment lines are left out") for warning in warnings):
        rows = [row for row in rows if not str(row[0]).startswith("#")]
    return header, rows


def _differences(data: bytes, poses: list[Pose], warnings: list[str]) -> str:
    header, rows = _told(data, warnings)
    if any(f"of {len(rows)} rows lack" in warning for warning in warnings):
        needed = [header.index(name) for name in ("target_deg", "reading_deg")]
        whole = [row for row in rows if all(row[place] is not None for place in needed)]
        if not any(warning.startswith(f"{len(rows) - len(whole)} of ") for warning in warnings):
            return f"{len(rows) - len(whole)} rows lack an angle, and another number is said"
        rows = whole
    if len(rows) != len(poses):
        return f"{len(rows)} rows went in and {len(poses)} poses came out"
    if any("they are sorted by it" in warning for warning in warnings):
        at = header.index("time_s")
        rows = sorted(rows, key=lambda row: row[at])
    read = [pose.row() for pose in poses]
    for place, name in enumerate(header):
        if name in read[0]:
            values = [row[name] for row in read]
            if values != [row[place] for row in rows]:
                return f"column {name!r} holds other values"
        elif not any(_tells(warning, name, place) for warning in warnings):
            return f"column {name!r} was left out without a word"
    return ""


def _tells(warning: str, name: str, place: int) -> bool:
    """Whether a warning says that a column was left out, or what it was read as."""
    is_read = warning.startswith("columns are read: ") and f"{name!r} as " in warning
    return is_read or warning.startswith(f"column {name or place + 1}: ")


def _log(data: bytes) -> str:
    log = read_static(data)
    header, rows = _told(data, log.warnings)
    if len(rows) != len(log):
        return f"{len(rows)} rows went in and {len(log)} samples came out"
    for place, name in enumerate(header):
        values = log.time_s if name == "time_s" else log.channels.get(name)
        if values is None:
            if not any(warning.startswith(f"column {name or place + 1} ") for warning in log.warnings):
                return f"column {name!r} was left out without a word"
        elif [None if value != value else value for value in values.tolist()] != [row[place] for row in rows]:
            return f"column {name!r} holds other values"
    return ""
