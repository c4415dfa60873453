"""Poses and raw samples of runs. The stage map of a run is applied to its poses as they are read."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any, Unpack

import numpy as np
from sqlmodel import Session, col, delete, func, insert, select
from sqlmodel.sql.expression import SelectOfScalar

from calrig.calibration.poses import Filtering, Pose
from calrig.calibration.separation import StageMap, with_map
from calrig.model.run import UNFINISHED
from calrig.store.convert import (
    joined_arrays,
    labelled_block,
    packed_arrays,
    pose_of,
    pose_values,
    run_row,
    unpacked_block,
)
from calrig.store.database import Repository
from calrig.store.errors import NotFound, Unreadable
from calrig.store.event_log import Announced
from calrig.store.records import RawSamples, RunChanges, SampleBlock, StoredPose, filtering_of, map_of
from calrig.store.runs import POSES_AT_ONCE, change
from calrig.store.tables import PoseTable, RunTable, SampleBlockTable


def _map_in_use(session: Session, run: RunTable) -> StageMap | None:
    """The map of a run; None where it has none, or a pose that counts stands beyond it.

    Half a run by a map and half by a certificate would have a step in it that is neither's.
    """
    try:
        kept = map_of(run.provenance)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise Unreadable(f"the stage's map of run {run.uid} is not what was stored: {error}") from error
    if kept is None:
        return None
    wanted = select(PoseTable.stage_deg, PoseTable.target_deg).where(
        PoseTable.run_id == run.id, col(PoseTable.excluded_reason).is_(None)
    )
    dial = [target if stage is None else stage for stage, target in session.exec(wanted)]
    return kept if kept.covers(np.array(dial, dtype=np.float64)).all() else None


def poses_of(session: Session, run: RunTable, *, include_excluded: bool = True) -> list[StoredPose]:
    """As `Poses.of`, of a session."""
    _require_all(session, run)
    wanted = _by_index(run).execution_options(yield_per=POSES_AT_ONCE)
    filtering = _filtering_of(run)
    found = (pose_of(pose, run.uid, filtering) for pose in session.exec(wanted))
    wanted_ones = [pose for pose in found if include_excluded or pose.excluded is None]
    return _put_upon(wanted_ones, _map_in_use(session, run))


def _put_upon(poses: Sequence[StoredPose], stage_map: StageMap | None) -> list[StoredPose]:
    """The poses with what the map adds to the dial."""
    if stage_map is None or not poses:
        return list(poses)
    mapped = with_map([one.pose for one in poses], stage_map)
    return [replace(one, pose=pose) for one, pose in zip(poses, mapped, strict=True)]


SAMPLES_AT_ONCE = 1_000
"""Read from the file together where they are asked for some at a time."""
BLOCKS_AT_ONCE = 8
"""Of a move or a dwell each."""
VARIABLES = 500
"""In one statement; SQLite takes a thousand."""


class Poses(Repository):
    """What runs measured."""

    def add(
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
            The events' numbers, as `EventLog.append`.
        """
        blocks = [_columns_of(block) for block in samples]
        with self._database.writing() as session:
            run = run_row(session, run_id)
            session.execute(insert(PoseTable), [pose_values(run.id, index, pose)])
            session.add_all(SampleBlockTable(run_id=run.id, **block) for block in blocks)
            return change(session, run, events, changes)

    def of(self, run_id: str, *, include_excluded: bool = True) -> list[StoredPose]:
        """The poses of a run by index."""
        with self._database.reading() as session:
            return poses_of(session, run_row(session, run_id), include_excluded=include_excluded)

    def batches_of(self, run_id: str) -> Iterator[list[StoredPose]]:
        """The same, excluded ones among them, some at a time as they are asked for.

        Raises:
            NotFound: at once where there is no such run.
        """
        with self._database.reading() as session:
            run = run_row(session, run_id)
            _require_all(session, run)
            filtering, wanted, in_use = _filtering_of(run), _by_index(run), _map_in_use(session, run)
        return self._batches(wanted, run_id, filtering, in_use)

    def _batches(
        self,
        wanted: SelectOfScalar[PoseTable],
        run_id: str,
        filtering: Filtering | None,
        in_use: StageMap | None,
    ) -> Iterator[list[StoredPose]]:
        last = -1
        while True:
            some = wanted.where(col(PoseTable.pose_index) > last).limit(POSES_AT_ONCE)
            with self._database.reading() as session:
                batch = [pose_of(pose, run_id, filtering) for pose in session.exec(some)]
            if not batch:
                return
            last = batch[-1].index
            yield _put_upon(batch, in_use)

    def count(self, run_id: str) -> int:
        """How many poses of a run count."""
        with self._database.reading() as session:
            run = run_row(session, run_id)
            counting = (PoseTable.run_id == run.id, col(PoseTable.excluded_reason).is_(None))
            return session.exec(select(func.count()).select_from(PoseTable).where(*counting)).one()

    def excluded(self, run_id: str) -> list[int]:
        """Indices of the poses of a run that do not count, in order."""
        with self._database.reading() as session:
            run = run_row(session, run_id)
            wanted = select(PoseTable.pose_index).where(
                PoseTable.run_id == run.id, col(PoseTable.excluded_reason).is_not(None)
            )
            return sorted(session.exec(wanted))


class Samples(Repository):
    """Raw samples of runs, in compressed blocks of one move or one dwell."""

    def add(
        self,
        run_id: str,
        samples: Sequence[SampleBlock],
        events: Sequence[Announced] = (),
        **changes: Unpack[RunChanges],
    ) -> list[int]:
        """Stores samples of no pose, as a static log has them, with events and changes as `Poses.add`."""
        blocks = [_columns_of(block) for block in samples]
        with self._database.writing() as session:
            run = run_row(session, run_id)
            session.add_all(SampleBlockTable(run_id=run.id, **block) for block in blocks)
            return change(session, run, events, changes)

    def of(self, run_id: str, pose: int | None = None) -> RawSamples:
        """The raw samples of a run in the order taken, or those of one pose's dwell; none once pruned.

        Raises:
            NotFound: the run has no such pose.
        """
        with self._database.reading() as session:
            numbers = [number for number, _ in _block_numbers(session, run_id, pose)]
            return joined_arrays(_packed_blocks(session, numbers))

    def blocks_of(self, run_id: str, pose: int | None = None) -> Iterator[RawSamples]:
        """The same, some at a time as they are asked for: a day of them does not fit into memory.

        Raises:
            NotFound: at once where the run has no such pose; later where the samples were pruned meanwhile.
        """
        with self._database.reading() as session:
            numbers = _block_numbers(session, run_id, pose)
        return self._unpacked(numbers)

    def _unpacked(self, numbers: Sequence[tuple[int, int]]) -> Iterator[RawSamples]:
        together: list[int] = []
        n_samples = 0
        for place, (number, n) in enumerate(numbers, start=1):
            together.append(number)
            n_samples += n
            if n_samples >= SAMPLES_AT_ONCE or place == len(numbers):
                with self._database.reading() as session:
                    unpacked = [unpacked_block(block) for block in _packed_blocks(session, together)]
                yield from unpacked
                together, n_samples = [], 0

    def labelled_blocks(self, run_id: str) -> Iterator[SampleBlock]:
        """The same of a whole run, each block with its pose and whether it is of a move or a dwell."""
        with self._database.reading() as session:
            numbers = _block_numbers(session, run_id, None)
        return self._labelled([number for number, _ in numbers])

    def _labelled(self, numbers: Sequence[int]) -> Iterator[SampleBlock]:
        for first in range(0, len(numbers), BLOCKS_AT_ONCE):
            some = numbers[first : first + BLOCKS_AT_ONCE]
            wanted = select(SampleBlockTable).where(col(SampleBlockTable.id).in_(some))
            with self._database.reading() as session:
                rows = session.exec(wanted.order_by(col(SampleBlockTable.id))).all()
                blocks = [labelled_block(row) for row in rows]
            if len(blocks) < len(some):
                raise NotFound("raw samples were deleted while they were read")
            yield from blocks

    def prune(self, before: datetime) -> int:
        """Deletes the raw samples of runs made before then and no longer going on; returns how many.

        `before` is an aware time.
        """
        old = select(RunTable.id).where(RunTable.created_at < before, col(RunTable.status).not_in(UNFINISHED))
        of_old_runs = col(SampleBlockTable.run_id).in_(old)
        with self._database.writing() as session:
            count = session.exec(select(func.sum(SampleBlockTable.n_samples)).where(of_old_runs)).one()
            session.execute(delete(SampleBlockTable).where(of_old_runs))
        self._database.give_back_space()
        return int(count or 0)


def _by_index(run: RunTable) -> SelectOfScalar[PoseTable]:
    return select(PoseTable).where(PoseTable.run_id == run.id).order_by(col(PoseTable.pose_index))


def _require_all(session: Session, run: RunTable) -> None:
    """Raises Unreadable where poses are missing: their number is stored with them, in one transaction."""
    stored = session.exec(select(func.count()).select_from(PoseTable).where(PoseTable.run_id == run.id)).one()
    try:
        missing = int(run.progress.get("poses_done", 0)) - stored
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise _not_as_stored(run, error) from error
    if missing > 0:
        raise Unreadable(f"{missing} poses of run {run.uid} are missing")


def _filtering_of(run: RunTable) -> Filtering | None:
    try:
        return filtering_of(run.provenance, run.plan)
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise _not_as_stored(run, error) from error


def _not_as_stored(run: RunTable, error: Exception) -> Unreadable:
    return Unreadable(f"the documents of run {run.uid} are not what was stored: {error}")


def _columns_of(block: SampleBlock) -> dict[str, Any]:
    """A block as the columns of its table, less the run; compresses, hence not for inside a transaction."""
    return {
        "pose_index": block.pose_index,
        "phase": block.phase,
        "n_samples": len(block.time_s),
        "data": packed_arrays(block),
    }


def _block_numbers(session: Session, run_id: str, pose: int | None) -> list[tuple[int, int]]:
    """Rows of a run's blocks in the order stored, or of one pose's dwell, each with its number of samples."""
    run = run_row(session, run_id)
    wanted = (
        select(SampleBlockTable.id, SampleBlockTable.n_samples)
        .where(SampleBlockTable.run_id == run.id)
        .order_by(col(SampleBlockTable.id))
    )
    if pose is not None:
        known = pose == 0 if run.kind == "static" else session.get(PoseTable, (run.id, min(pose, 2**62)))
        if pose < 0 or not known:
            raise NotFound(f"run {run_id} has no pose {pose}")
        wanted = wanted.where(SampleBlockTable.pose_index == pose, SampleBlockTable.phase == "dwell")
    return [(number or 0, n_samples) for number, n_samples in session.exec(wanted)]


def _packed_blocks(session: Session, numbers: Sequence[int]) -> list[bytes]:
    packed: list[bytes] = []
    for first in range(0, len(numbers), VARIABLES):
        some = col(SampleBlockTable.id).in_(numbers[first : first + VARIABLES])
        packed += session.exec(select(SampleBlockTable.data).where(some).order_by(col(SampleBlockTable.id)))
    if len(packed) < len(numbers):
        raise NotFound("raw samples were deleted while they were read")
    return packed
