"""Re-analyse every completed run with today's catalogue: screen all, diagnose those that stand out.

The work is distributed to processes of this machine or to other workers. The runs are summed into one mean
error map a rig as they are read. A million runs are no joint solution: the mean also holds what the units
have in common. The rig's own map (`calrig.analysis.error_map`) is solved from its newest runs.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from calrig.analysis.diagnoses import Diagnoses
from calrig.analysis.errors import RunsError
from calrig.analysis.stored_runs import last_request, poses_together, runs_together
from calrig.calibration.fleet_screen import screen
from calrig.calibration.packed_poses import PackedPoses, packed
from calrig.calibration.poses import DiagnosisError
from calrig.calibration.regression import DiagnosisRequest
from calrig.errors import WorkError
from calrig.estimation.angles import FloatArray
from calrig.export.poses_parquet import parquet_files, read_file
from calrig.processes.pool import Processes
from calrig.processes.pool import WorkError as HeavyWorkError
from calrig.program_text import sha256_of_program
from calrig.store.errors import StoreError, StoreUnavailableError

if TYPE_CHECKING:
    from calrig.store import Store
    from calrig.store.fleet import ListedRun


T = TypeVar("T")
K = TypeVar("K")
R = TypeVar("R")
AHEAD = 2
"""Questions to a worker that are ready when it has answered; more would only fill memory."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Those that are there: `slots` carry something out at once."""

    submit: Callable[[Callable[[], Any]], Future[Any]]
    slots: int
    what: str

    def answers(self, questions: Iterable[tuple[K, Callable[[], T]]]) -> Iterator[tuple[K, T | Exception]]:
        """What each question gave, or raised, in the order answered; as many are asked as keep all busy."""
        asked: dict[Future[T], K] = {}
        for key, question in questions:
            asked[self.submit(question)] = key
            while len(asked) >= AHEAD * self.slots:
                yield from _done(asked)
        while asked:
            yield from _done(asked)


def _done(asked: dict[Future[T], K]) -> Iterator[tuple[K, T | Exception]]:
    finished, _ = wait(asked, return_when=FIRST_COMPLETED)
    for future in finished:
        key, error = asked.pop(future), future.exception()
        if error is not None and not isinstance(error, Exception):
            raise error
        yield key, future.result() if error is None else error


@contextmanager
def own_processes(slots: int | None = None) -> Iterator[Workers]:
    """Processes of calrig's own, without a number one a core; each piece has a bound of time and memory."""
    slots = slots or len(os.sched_getaffinity(0))
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="fleet", daemon=True)
    thread.start()
    processes = Processes(slots)
    try:
        yield Workers(
            lambda question: asyncio.run_coroutine_threadsafe(processes.run(question), loop),
            slots,
            f"{slots} processes",
        )
    finally:
        asyncio.run_coroutine_threadsafe(_end(processes), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


async def _end(processes: Processes) -> None:
    pieces = asyncio.all_tasks() - {asyncio.current_task()}
    for piece in pieces:
        piece.cancel()
    await asyncio.gather(*pieces, return_exceptions=True)
    await processes.close()


FEWEST_UNITS = 3
PLACE_DEG = 1.0
"""Poses closer than this in elevation are taken for one place."""
CAVEAT = "common firmware, a common cable or a common sensor design would look the same"
APPROACHES = 3
MIDDLE = 2**20
"""Stands for a place of 0°, so that no key is below 0; of nearly three thousand turns either way."""
Keys = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MeanMap:
    """Mean residual over units by elevation and approach, with its standard error between units."""

    stage_deg: list[float]
    approach: list[int]
    error_deg: list[float]
    std_deg: list[float]
    units: int
    caveat: str = CAVEAT


@dataclass(frozen=True, slots=True, eq=False)
class PlaceSums:
    """Sums of residuals by rig and unit, elevation and approach.

    Attributes:
        pair: (K,) index into those.
        place: (K,) elevation in steps of `PLACE_DEG` with the approach, as one number that orders both.
        sums, counts: (K,) of the residuals, in degrees.
    """

    pairs: tuple[tuple[str, str], ...]
    pair: Keys
    place: Keys
    sums: FloatArray
    counts: FloatArray


def place_sums(poses: PackedPoses, scale: FloatArray, residual_deg: FloatArray) -> PlaceSums:
    """Those of runs of a known unit on a known rig that turned it.

    `poses` are of R runs; `scale` (R,) is NaN where none is known, `residual_deg` (N,) what calibration
    leaves.
    """
    codes: dict[tuple[str, str], int] = {}
    of_run = np.full(len(poses), -1, dtype=np.int64)
    for k, (rig, unit) in enumerate(zip(poses.rigs, poses.units, strict=True)):
        if rig is not None and unit is not None:
            of_run[k] = codes.setdefault((rig, unit), len(codes))
    of_run[np.isnan(scale)] = -1
    pair = np.repeat(of_run, poses.counts)
    approach = np.nan_to_num(poses.columns.get("approach", np.zeros(len(pair))))
    step = np.rint(poses.theta_deg / PLACE_DEG)
    place = (APPROACHES * (step + MIDDLE) + np.sign(approach) + 1).astype(np.int64)
    counts = (pair >= 0) & np.isfinite(residual_deg)
    ones = np.ones(int(counts.sum()))
    return _summed(tuple(codes), pair[counts], place[counts], residual_deg[counts], ones)


def merged(parts: Iterable[PlaceSums]) -> PlaceSums:
    """The sums of several parts together."""
    codes: dict[tuple[str, str], int] = {}
    renamed: list[tuple[Keys, Keys, FloatArray, FloatArray]] = []
    for part in parts:
        new = np.array([codes.setdefault(pair, len(codes)) for pair in part.pairs], dtype=np.int64)
        renamed.append((new[part.pair], part.place, part.sums, part.counts))
    if not renamed:
        nothing = np.empty(0, dtype=np.int64)
        return PlaceSums((), nothing, nothing, np.empty(0), np.empty(0))
    pair, place, sums, counts = (np.concatenate(columns) for columns in zip(*renamed, strict=True))
    return _summed(tuple(codes), pair, place, sums, counts)


def _summed(
    pairs: tuple[tuple[str, str], ...], pair: Keys, place: Keys, sums: FloatArray, counts: FloatArray
) -> PlaceSums:
    """Rows of the same pair and place as one."""
    if len(pair) == 0:
        return PlaceSums(pairs, pair, place, sums, counts)
    order = np.argsort(pair * (2 * APPROACHES * MIDDLE) + place)
    pair, place = pair[order], place[order]
    begins = np.flatnonzero(np.diff(pair, prepend=-1) | np.diff(place, prepend=-1))
    summed, counted = (np.add.reduceat(values[order], begins) for values in (sums, counts))
    return PlaceSums(pairs, pair[begins], place[begins], summed, counted)


def rig_maps(sums: PlaceSums) -> dict[str, MeanMap]:
    """The map of each rig, by name: every unit counts once at each place, however many runs it has."""
    rigs = np.array([rig for rig, _ in sums.pairs])
    names, of_pair = np.unique(rigs, return_inverse=True) if len(rigs) else (rigs, np.empty(0, dtype=np.intp))
    known = np.unique(sums.pair)
    units = np.bincount(of_pair[known], minlength=len(names))
    rig, means = of_pair[sums.pair], sums.sums / np.maximum(sums.counts, 1.0)
    return {
        str(name): _map(sums.place[rig == k], means[rig == k], int(units[k])) for k, name in enumerate(names)
    }


def _map(place: Keys, mean_deg: FloatArray, units: int) -> MeanMap:
    """Of the means of all units (K,) of one rig at each place (K,)."""
    places, inverse, n = np.unique(place, return_inverse=True, return_counts=True)
    mean = np.bincount(inverse, mean_deg) / n if len(n) else np.empty(0)
    squares = np.bincount(inverse, (mean_deg - mean[inverse]) ** 2) if len(n) else np.empty(0)
    common = n >= FEWEST_UNITS
    std = [math.sqrt(s / (m - 1) / m) for s, m in zip(squares[common], n[common].tolist(), strict=True)]
    step, approach = np.divmod(places[common], APPROACHES)
    return MeanMap(
        [PLACE_DEG * (k - MIDDLE) for k in step.tolist()],
        [k - 1 for k in approach.tolist()],
        mean[common].tolist(),
        std,
        units,
    )


Progress = Callable[[str], AbstractContextManager[Callable[[float], None]]]
OF_THE_CATALOGUE = ("calibration", "estimation")
"""Packages that decide what a diagnosis says."""
MAPS_TOGETHER = 64
"""Parts of maps that are summed up together."""
NOTHING = (None, "nothing")


@dataclass(frozen=True, slots=True)
class Glanced:
    """What the screen says of some runs.

    Attributes:
        sums: for the rigs' maps.
        failed: why, by the id, of those that could not be read or screened.
    """

    run_ids: tuple[str, ...]
    standing_out: tuple[str, ...]
    sums: PlaceSums
    failed: dict[str, str] = field(default_factory=dict)


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
    """Reads all runs once more; CONTRACT section 10's document, and why runs in `failed` have no part in it.

    A run that cannot be read, or whose diagnosis is lost, is told there and keeps no other one from being
    read. Nothing is kept of it, so that the next call tries it again. A run is diagnosed that stands out, or
    in which something was found before. What is found is kept as soon as it is known, and not looked for
    again in the same poses by the same catalogue.

    Args:
        store: with the runs.
        results: where findings are kept; may be the same.
        workers: who diagnoses; asked for once there is something to do.
        progress: shows how far a step is that it is given the name of.
        poses: Parquet files to screen in the place of the store's poses; runs they lack are read from it.

    Raises:
        WorkError: a worker runs another calrig.
        InputError: the Parquet files cannot be read.
        StoreError: the store cannot.
    """
    began_s = time.monotonic()
    listed = {run.id: run for part in store.fleet.completed_runs() for run in part}
    with progress("screening") as show:
        standing_out, sums, failed = _screened(store, listed, poses, show)
    chosen = [
        run
        for run in listed.values()
        if run.id not in failed and (run.id in standing_out or run.verdict not in NOTHING)
    ]
    with progress("diagnosing") as show:
        verdicts, lost = _diagnosed(store, results, chosen, workers, show)
    changed = [
        {"run_id": run.id, "verdict_before": run.verdict, "verdict_now": now}
        for run in chosen
        if run.id not in lost
        and (now := verdicts[run.id]) != run.verdict
        and {now, run.verdict} != set(NOTHING)
    ]
    return {
        "runs": len(listed),
        "changed": changed,
        "failed": [{"run_id": run_id, "error": error} for run_id, error in (failed | lost).items()],
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
    found: list[Glanced] = []
    for poses in read_file(file):
        wanted = [k for k, run in enumerate(poses.run_ids) if run not in but]
        found += _glances(partial(_glance_at, poses), wanted, poses.run_ids.__getitem__)
    return found


def _glance_at(poses: PackedPoses, some: Sequence[int]) -> Glanced:
    return glance(poses.runs(np.array(some, dtype=np.intp)))


def _glances(
    work: Callable[[Sequence[R]], Glanced], runs: Sequence[R], id_of: Callable[[R], str]
) -> Iterator[Glanced]:
    """Screens some runs together; if that fails, each half of them, so that a run fails alone.

    Raises:
        StoreUnavailableError: not because of a run.
    """
    if not runs:
        return
    try:
        found = work(runs)
    except StoreUnavailableError:
        raise
    except Exception as error:  # noqa: BLE001 (whatever it is, the report tells it of its run)
        if len(runs) > 1:
            middle = len(runs) // 2
            yield from _glances(work, runs[:middle], id_of)
            yield from _glances(work, runs[middle:], id_of)
            return
        run_id = id_of(runs[0])
        found = Glanced((run_id,), (), merged(()), {run_id: _reason(error)})
    yield found


def _reason(error: Exception) -> str:
    """What a report says of a run that failed, in one line."""
    said = " ".join(str(error).split())
    in_words = isinstance(error, StoreError | HeavyWorkError | RunsError)
    return said if in_words else f"{type(error).__name__}: {said}"


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
) -> tuple[set[str], PlaceSums, dict[str, str]]:
    """Ids of the runs that stand out, the sums for the rigs' maps, and why runs failed."""
    standing_out: set[str] = set()
    failed: dict[str, str] = {}
    seen: set[str] = set()
    parts: list[PlaceSums] = []

    def take(glanced: Iterable[Glanced]) -> None:
        for one in glanced:
            seen.update(one.run_ids)
            standing_out.update(one.standing_out)
            failed.update(one.failed)
            parts.append(one.sums)
        if len(parts) > MAPS_TOGETHER:
            parts[:] = [merged(parts)]
        show(len(seen) / max(len(listed), 1))

    if poses is not None:
        for glanced in glance_at_files(parquet_files(poses), listed.__contains__):
            take(glanced)

    def read(some: Sequence[ListedRun]) -> Glanced:
        (piece,) = store.fleet.packed_poses(some)
        return glance(piece)

    for some in store.fleet.pieces([run for run in listed.values() if run.id not in seen]):
        take(_glances(read, some, lambda run: run.id))
    return standing_out, merged(parts), failed


def _diagnosed(
    store: Store,
    results: Store,
    chosen: Sequence[ListedRun],
    workers: Callable[[], AbstractContextManager[Workers]],
    show: Callable[[float], None],
) -> tuple[dict[str, str | None], dict[str, str]]:
    """Today's verdict on each of these runs, None where it cannot be diagnosed; and why others failed."""
    kept, today = results.findings.all(), catalogue_version()
    verdicts: dict[str, str | None] = {}
    lost: dict[str, str] = {}
    waiting: list[str] = []
    for run in chosen:
        known = kept.get(run.id)
        if known is not None and known.catalogue == today:
            with _told_of(run.id, lost):
                if known.poses_sha256 == poses_sha256(store, run.id):
                    verdicts[run.id] = known.verdict
        if run.id not in verdicts and run.id not in lost:
            waiting.append(run.id)
    if not waiting:
        return verdicts, lost

    def asked() -> Iterator[tuple[tuple[str, str], Callable[[], Answer]]]:
        for run_id in waiting:
            with _told_of(run_id, lost):
                one = (run_id, poses_sha256(store, run_id)), _question(store, run_id)
            if run_id not in lost:
                yield one

    with workers() as found:
        for (run_id, sha256), answer in found.answers(asked()):
            if isinstance(answer, Exception):
                lost[run_id] = _reason(answer)
                continue
            if answer.catalogue != today:
                raise WorkError(f"{found.what}: run another calrig than this one: install the same there")
            results.findings.save(run_id, sha256, today, answer.diagnosis, answer.error)
            verdicts[run_id] = None if answer.diagnosis is None else answer.diagnosis["verdict"]
            show(len(verdicts) / len(chosen))
    return verdicts, lost


@contextmanager
def _told_of(run_id: str, failed: dict[str, str]) -> Iterator[None]:
    """Note what the block raises as why the run failed; a store that is unavailable fails no run alone."""
    try:
        yield
    except StoreUnavailableError:
        raise
    except Exception as error:  # noqa: BLE001 (whatever it is, the report tells it of its run)
        failed[run_id] = _reason(error)


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
    if (run := store.runs.get(run_id)) is not None and (request := last_request(run)) != DiagnosisRequest():
        digest.update(repr(request).encode())
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
