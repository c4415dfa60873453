"""Every completed run once more by today's catalogue: all are screened, those that stand out diagnosed."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calrig.analysis.diagnoses import Diagnoses
from calrig.analysis.errors import RunsError
from calrig.analysis.fleet_maps import PlaceSums, merged, place_sums, rig_maps
from calrig.analysis.fleet_workers import Workers, own_processes
from calrig.analysis.stored_runs import poses_together, runs_together
from calrig.calibration.fleet_screen import PackedPoses, packed, screen
from calrig.calibration.poses import DiagnosisError
from calrig.errors import WorkError
from calrig.export.poses_parquet import parquet_files, read_file
from calrig.program_text import sha256_of_program

if TYPE_CHECKING:
    from calrig.store import Store
    from calrig.store.fleet import ListedRun

Progress = Callable[[str], AbstractContextManager[Callable[[float], None]]]
OF_THE_CATALOGUE = ("calibration", "estimation")
"""Packages that decide what a diagnosis says."""
MAPS_TOGETHER = 64
"""Parts of maps that are summed up together."""
NOTHING = (None, "nothing")


@dataclass(frozen=True, slots=True)
class Glanced:
    """What the screen says of some runs: their ids, those that stand out, and sums for the rigs' maps."""

    run_ids: tuple[str, ...]
    standing_out: tuple[str, ...]
    sums: PlaceSums


@dataclass(frozen=True, slots=True)
class Answer:
    """A diagnosis, or why there is none, and the catalogue that gave it."""

    catalogue: str
    diagnosis: dict[str, Any] | None
    error: str | None


def catalogue_version() -> str:
    """SHA-256 of the program text that decides what a diagnosis says: nothing else makes its verdicts."""
    return sha256_of_program(*OF_THE_CATALOGUE)


def reanalyse(
    store: Store,
    results: Store,
    workers: Callable[[], AbstractContextManager[Workers]],
    progress: Progress,
    poses: Path | None = None,
) -> dict[str, Any]:
    """Reads all runs once more; CONTRACT section 10's document.

    A run is diagnosed that stands out, or in which something was found before. What is found is kept as soon
    as it is known, and not looked for again in the same poses by the same catalogue.

    Args:
        store: with the runs.
        results: where findings are kept; may be the same.
        workers: who diagnoses; asked for once there is something to do.
        progress: shows how far a step is that it is given the name of.
        poses: Parquet files to screen in the place of the store's poses; runs they lack are read from it.

    Raises:
        WorkError: diagnoses were lost; those that were made are kept.
        InputError: the Parquet files cannot be read.
        StoreError: the store cannot.
    """
    began_s = time.monotonic()
    listed = {run.id: run for part in store.completed_runs() for run in part}
    with progress("screening") as show:
        standing_out, sums = _screened(store, listed, poses, show)
    chosen = [run for run in listed.values() if run.id in standing_out or run.verdict not in NOTHING]
    with progress("diagnosing") as show:
        verdicts = _diagnosed(store, results, chosen, workers, show)
    changed = [
        {"run_id": run.id, "verdict_before": run.verdict, "verdict_now": now}
        for run in chosen
        if (now := verdicts[run.id]) != run.verdict and {now, run.verdict} != set(NOTHING)
    ]
    return {
        "runs": len(listed),
        "changed": changed,
        "rigs": _maps(sums),
        "duration_s": time.monotonic() - began_s,
    }


def _maps(sums: PlaceSums) -> list[dict[str, Any]]:
    found = []
    for rig, error_map in rig_maps(sums).items():
        columns = asdict(error_map)
        units = columns.pop("units")
        found.append({"rig": rig, "map": columns, "units": units})
    return found


def glance(poses: PackedPoses) -> Glanced:
    """Screens some runs."""
    poses = poses.of_first_mounts()
    seen = screen(poses)
    standing_out = tuple(poses.run_ids[k] for k in np.flatnonzero(seen.stands_out))
    return Glanced(poses.run_ids, standing_out, place_sums(poses, seen.scale, seen.residual_deg))


def glance_at_file(file: Path, but: frozenset[str] = frozenset()) -> list[Glanced]:
    """Screens the runs of a Parquet file, but for some."""
    found = []
    for poses in read_file(file):
        wanted = [k for k, run in enumerate(poses.run_ids) if run not in but]
        found.append(glance(poses.runs(np.array(wanted, dtype=np.intp)) if but else poses))
    return found


def glance_at_files(
    files: Sequence[Path], known: Callable[[str], bool] = lambda _: True, slots: int | None = None
) -> Iterator[list[Glanced]]:
    """Screens the runs of Parquet files that are known, so many files at once, else one a core."""
    with own_processes(slots) as own:
        again: list[tuple[Path, frozenset[str]]] = [(file, frozenset()) for file in files]
        while again:
            asked = [((file, but), partial(glance_at_file, file, but)) for file, but in again]
            again = []
            for (file, but), answer in own.answers(asked):
                if isinstance(answer, Exception):
                    raise answer
                strange = {run for one in answer for run in one.run_ids if not known(run)}
                if strange:  # it is rare, and who screens a file need not be told a million names
                    again.append((file, but | strange))
                else:
                    yield answer


def _screened(
    store: Store, listed: dict[str, ListedRun], poses: Path | None, show: Callable[[float], None]
) -> tuple[set[str], PlaceSums]:
    """Ids of the runs that stand out, and the sums for the rigs' maps."""
    standing_out: set[str] = set()
    seen: set[str] = set()
    parts: list[PlaceSums] = []

    def take(glanced: Iterable[Glanced]) -> None:
        for one in glanced:
            seen.update(one.run_ids)
            standing_out.update(one.standing_out)
            parts.append(one.sums)
        if len(parts) > MAPS_TOGETHER:
            parts[:] = [merged(parts)]
        show(len(seen) / max(len(listed), 1))

    if poses is not None:
        for glanced in glance_at_files(parquet_files(poses), listed.__contains__):
            take(glanced)
    for piece in store.packed_poses([run for run in listed.values() if run.id not in seen]):
        take([glance(piece)])
    return standing_out, merged(parts)


def _diagnosed(
    store: Store,
    results: Store,
    chosen: Sequence[ListedRun],
    workers: Callable[[], AbstractContextManager[Workers]],
    show: Callable[[float], None],
) -> dict[str, str | None]:
    """Today's verdict on each of these runs, None where it cannot be diagnosed."""
    kept, today = results.findings(), catalogue_version()
    verdicts = {
        run.id: known.verdict
        for run in chosen
        if (known := kept.get(run.id)) is not None
        and known.catalogue == today
        and known.poses_sha256 == poses_sha256(store, run.id)
    }
    waiting = [run.id for run in chosen if run.id not in verdicts]
    if not waiting:
        return verdicts
    lost: dict[str, Exception] = {}
    with workers() as found:
        asked = (((run_id, poses_sha256(store, run_id)), _question(store, run_id)) for run_id in waiting)
        for (run_id, sha256), answer in found.answers(asked):
            if isinstance(answer, Exception):
                lost[run_id] = answer
                continue
            if answer.catalogue != today:
                raise WorkError(f"{found.what}: run another calrig than this one: install the same there")
            results.keep_finding(run_id, sha256, today, answer.diagnosis, answer.error)
            verdicts[run_id] = None if answer.diagnosis is None else answer.diagnosis["verdict"]
            show(len(verdicts) / len(chosen))
    for run_id, error in lost.items():
        raise WorkError(
            f"{len(lost)} of {len(waiting)} diagnoses were lost, of run {run_id} first ({error}); the others "
            "are kept: the same command goes on with what is left"
        )
    return verdicts


def poses_sha256(store: Store, run_id: str) -> str:
    """SHA-256 of the poses that a run's diagnosis rests on, with the filter that they were read by."""
    digest = hashlib.sha256()
    try:
        together = poses_together(store, runs_together(store, run_id))
    except RunsError as error:
        together = []
        digest.update(str(error).encode())
    for poses in together:
        columns = packed({"": poses}).columns
        for name, column in columns.items():
            digest.update(f"{name}\0{len(column)}\0".encode() + column.tobytes())
        digest.update(repr(poses[0].filtering if poses else None).encode())
    return digest.hexdigest()


def _question(store: Store, run_id: str) -> Callable[[], Answer]:
    """What a run's poses are to be asked, as a worker is given it."""
    try:
        return partial(answered, Diagnoses(store).question(run_id))
    except RunsError as error:
        return partial(answered, str(error))


def answered(question: Callable[[], dict[str, Any]] | str) -> Answer:
    """The answer to a question, or the words for why it cannot be asked."""
    if isinstance(question, str):
        return Answer(catalogue_version(), None, question)
    try:
        return Answer(catalogue_version(), question(), None)
    except DiagnosisError as error:
        return Answer(catalogue_version(), None, str(error))
