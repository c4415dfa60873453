"""The store: every run, pose, event and raw sample, in one SQLite file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from types import TracebackType
from typing import Self, Unpack

from calrig.calibration.pose import Pose
from calrig.store import convert, effects, event_log, history, poses, runs, transcripts
from calrig.store.database import BUSY_TIMEOUT_S, Database, database_path
from calrig.store.event_log import Announced
from calrig.store.records import (
    AcceptedEffect,
    ComparisonRow,
    Document,
    Event,
    RawSamples,
    Run,
    RunChanges,
    SampleBlock,
    Size,
    Status,
    StoredPose,
    Unit,
)

SAMPLES_AT_ONCE = 1_000
"""Read from the file together where they are asked for some at a time."""


class Store:
    """An open store, shared by threads. Each method is one transaction, on the disk when it returns.

    A run that does not exist raises `NotFound` where it is not said otherwise; what SQLite cannot do raises
    `StoreError`; a document with a NaN in it raises ValueError (what is not known is None).
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    @classmethod
    def open(
        cls,
        url: str,
        *,
        writer: str | None,
        busy_timeout_s: float = BUSY_TIMEOUT_S,
        left_by_the_dead: Callable[[Sequence[str]], None] = lambda _: None,
    ) -> Self:
        """Opens a store; a writer makes it where there is none and brings an older one up to date.

        Args:
            url: SQLAlchemy URL of a SQLite file, as `calrig.settings.store_url` gives it.
            writer: what the writer does (`serve`, `run`, `import`), told to whoever finds the store taken;
                None opens it for reading, which always may.
            busy_timeout_s: how long to wait for another process's lock on the file.
            left_by_the_dead: is told by a writer which rigs have unfinished runs, which no living program
                carries out, before anything else is done: looking through a large file can take a while.

        Raises:
            StoreError: another writer holds it; it is absent (for a reader), older (for a reader), newer,
                not SQLite, another program's, unreadable, read-only, or the disk is full.
        """
        return cls(Database(database_path(url), writer, busy_timeout_s, left_by_the_dead))

    def close(self) -> None:
        """Closes the file and lets another writer in."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()

    def create_run(
        self,
        *,
        unit: str,
        rig: str | None,
        plan: Document | None,
        status: Status,
        provenance: Document,
        operator: str | None = None,
        note: str | None = None,
        follows: str | None = None,
        poses_total: int = 0,
        poses: Sequence[Pose] = (),
        result: Document | None = None,
    ) -> Run:
        """Makes a run and, where it is the first of its unit, the unit; announces the run's state.

        An import gives `poses`, `result` and the status `completed` at once: all is stored or nothing.
        """
        with self._database.writing() as session:
            return runs.create(
                session,
                unit=unit,
                rig=rig,
                plan=plan,
                status=status,
                provenance=provenance,
                operator=operator,
                note=note,
                follows=follows,
                poses_total=poses_total,
                poses=poses,
                result=result,
            )

    def run(self, run_id: str) -> Run | None:
        """The run, or None."""
        with self._database.reading() as session:
            return runs.find(session, run_id)

    def runs(
        self,
        *,
        unit: str | None = None,
        rig: str | None = None,
        status: str | None = None,
        limit: int = 50,
        cursor: str | None = None,
    ) -> tuple[list[Run], str | None]:
        """A page of runs, the newest first, and the cursor of the next page (None after the last).

        A cursor stays good while runs are added: no run is shown twice or left out.

        Raises:
            ValueError: the cursor is not one that this method gave, or the limit is below 1.
        """
        with self._database.reading() as session:
            return runs.page(session, unit=unit, rig=rig, status=status, limit=limit, cursor=cursor)

    def update_run(
        self, run_id: str, *, events: Sequence[Announced] = (), **changes: Unpack[RunChanges]
    ) -> Run:
        """Changes a run and announces `events`, then, where a status was given, the new state.

        `started_at` is set by the first `running`, `finished_at` by a terminal status; a run that is taken
        up again loses `finished_at`. `error` stays unless given: clear it when a run is resumed.
        """
        with self._database.writing() as session:
            return runs.update(session, run_id, events, changes)

    def set_result(self, run_id: str, result: Document | None) -> Run:
        """Replaces a run's result, and with it what comparisons show."""
        return self.update_run(run_id, result=result)

    def void_run(self, run_id: str, reason: str) -> Run:
        """Takes a run out of every comparison; it is kept. A second reason replaces the first."""
        with self._database.writing() as session:
            return runs.void(session, run_id, reason)

    def unfinished(self) -> list[Run]:
        """The runs that are queued, running or paused, the oldest first."""
        with self._database.reading() as session:
            return runs.unfinished(session)

    def append_events(self, run_id: str, events: Sequence[Announced]) -> list[int]:
        """Appends events to a run's log.

        Returns:
            Their numbers within the run, from 1 and without gaps.
        """
        with self._database.writing() as session:
            return event_log.append(session, runs.row_of(session, run_id), events)

    def events_after(self, run_id: str, seq: int = 0, limit: int = 1000) -> list[Event]:
        """At most `limit` events that follow number `seq`, in order."""
        with self._database.reading() as session:
            return event_log.after(session, runs.row_of(session, run_id), seq, limit)

    def add_pose(
        self,
        run_id: str,
        index: int,
        pose: Pose,
        samples: Sequence[SampleBlock] = (),
        events: Sequence[Announced] = (),
        **changes: Unpack[RunChanges],
    ) -> list[int]:
        """Stores a pose, its samples, its events and what it changes of the run (progress, faults) together.

        So what was announced is in the database.

        Returns:
            The events' numbers, as `append_events`.
        """
        blocks = [poses.row_of(run_id, block) for block in samples]
        with self._database.writing() as session:
            run = runs.row_of(session, run_id)
            poses.add(session, run, index, pose, blocks)
            return runs.change(session, run, events, changes)

    def add_samples(
        self,
        run_id: str,
        samples: Sequence[SampleBlock],
        events: Sequence[Announced] = (),
        **changes: Unpack[RunChanges],
    ) -> list[int]:
        """Stores samples of no pose, as a static log has them, with events and changes as `add_pose`."""
        blocks = [poses.row_of(run_id, block) for block in samples]
        with self._database.writing() as session:
            run = runs.row_of(session, run_id)
            session.add_all(blocks)
            return runs.change(session, run, events, changes)

    def poses(self, run_id: str, *, include_excluded: bool = True) -> list[StoredPose]:
        """The poses of a run by index."""
        with self._database.reading() as session:
            return poses.of_run(session, run_id, include_excluded=include_excluded)

    def exclude_pose(self, run_id: str, index: int, reason: str, *, result: Document | None) -> Run:
        """Marks a pose as not counting and replaces the run's result; the pose is kept.

        Args:
            run_id: the run.
            index: the pose.
            reason: why it does not count; a second one replaces the first.
            result: what the poses that are left give.

        Raises:
            NotFound: the run has no such pose.
        """
        with self._database.writing() as session:
            return poses.exclude(session, run_id, index, reason, result)

    def accept_effects(self, run_id: str, accepted: Sequence[AcceptedEffect]) -> None:
        """Puts effects of a run's diagnosis in force from now on; the diagnosis says since when.

        Each for its unit or its rig, in place of an earlier one of that name.
        """
        with self._database.writing() as session:
            effects.accept(session, run_id, accepted)

    def effects_in_force(self, unit: str, rig: str | None) -> list[AcceptedEffect]:
        """The effects accepted for a unit and for a rig, the latest of each name."""
        with self._database.reading() as session:
            return effects.in_force(session, unit, rig)

    def effect_names(self) -> dict[str, list[str]]:
        """Names of the effects accepted for each unit that has any."""
        with self._database.reading() as session:
            return effects.names(session)

    def keep_transcripts(self, run_id: str, texts: Mapping[str, str]) -> None:
        """Keeps what went over each port of a run."""
        with self._database.writing() as session:
            transcripts.keep(session, run_id, texts)

    def transcripts(self, run_id: str) -> dict[str, str]:
        """What went over each port in the last minute before the run failed; empty where it did not."""
        with self._database.reading() as session:
            return transcripts.of_run(session, run_id)

    def samples(self, run_id: str, pose: int | None = None) -> RawSamples:
        """The raw samples of a run in the order taken, or those of one pose's dwell; none once pruned.

        Raises:
            NotFound: the run has no such pose.
        """
        with self._database.reading() as session:
            return convert.joined_arrays(poses.packed_samples(session, run_id, pose))

    def sample_blocks(self, run_id: str, pose: int | None = None) -> Iterator[RawSamples]:
        """The same, some at a time as they are asked for: a day of them does not fit into memory.

        Raises:
            NotFound: at once where the run has no such pose; later where the samples were pruned meanwhile.
        """
        with self._database.reading() as session:
            numbers = poses.block_numbers(session, run_id, pose)
        return self._unpacked(numbers)

    def _unpacked(self, numbers: Sequence[tuple[int, int]]) -> Iterator[RawSamples]:
        together: list[int] = []
        n_samples = 0
        for place, (number, n) in enumerate(numbers, start=1):
            together.append(number)
            n_samples += n
            if n_samples >= SAMPLES_AT_ONCE or place == len(numbers):
                with self._database.reading() as session:
                    packed = poses.packed_blocks(session, together)
                    unpacked = [convert.unpacked_block(block) for block in packed]
                yield from unpacked
                together, n_samples = [], 0

    def prune_samples(self, before: datetime) -> int:
        """Deletes the raw samples of runs made before then and no longer going on, and nothing else.

        Args:
            before: an aware time.

        Returns:
            How many samples were deleted.
        """
        with self._database.writing() as session:
            count = poses.prune_samples(session, before)
        self._database.give_back_space()
        return count

    def count_runs(self) -> dict[str, int]:
        """How many runs there are of each status."""
        with self._database.reading() as session:
            return history.count_runs(session)

    def size(self) -> Size:
        """What the store takes of its disk."""
        return self._database.size()

    def units(self) -> list[Unit]:
        """Every unit by serial number."""
        with self._database.reading() as session:
            return history.units(session)

    def unit(self, serial: str) -> Unit | None:
        """The unit, or None."""
        with self._database.reading() as session:
            return next(iter(history.units(session, serial)), None)

    def comparison(self, serials: Sequence[str] | None = None) -> list[ComparisonRow]:
        """The figures of every completed, not voided calibration, by unit, the oldest of each first.

        Args:
            serials: the units to compare; None for all.
        """
        with self._database.reading() as session:
            return history.comparison(session, serials)

    def latest_calibration_run(self, serial: str) -> Run | None:
        """The latest completed, not voided `calibration` run (or import) whose scale is known, or None."""
        with self._database.reading() as session:
            return history.latest_calibration(session, serial)
