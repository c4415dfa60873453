"""Poses and their raw samples, inside a transaction that the store has begun."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from sqlmodel import Session, col, delete, func, insert, select

from calrig.calibration.pose import Pose
from calrig.store import convert, runs
from calrig.store.errors import NotFound, Unreadable
from calrig.store.records import UNFINISHED, Document, Run, SampleBlock, StoredPose
from calrig.store.tables import PoseTable, RunTable, SampleBlockTable

VARIABLES = 500
"""In one statement; SQLite takes a thousand."""


def add(session: Session, run: RunTable, index: int, pose: Pose, blocks: Sequence[SampleBlockTable]) -> None:
    """Adds a pose and the raw samples it rests on."""
    session.execute(insert(PoseTable), [convert.pose_values(run.id, index, pose)])
    session.add_all(blocks)


def row_of(run_id: str, block: SampleBlock) -> SampleBlockTable:
    """A block as a row; compresses, hence not for inside a transaction."""
    return SampleBlockTable(
        run_id=runs.number(run_id) or 0,
        pose_index=block.pose_index,
        phase=block.phase,
        n_samples=len(block.time_s),
        data=convert.packed_arrays(block),
    )


def of_run(session: Session, run_id: str, *, include_excluded: bool) -> list[StoredPose]:
    """As `Store.poses`."""
    row = runs.row_of(session, run_id)
    wanted = select(PoseTable).where(PoseTable.run_id == row.id).order_by(col(PoseTable.pose_index))
    found = [convert.pose_of(pose) for pose in session.exec(wanted)]
    missing = row.progress.get("poses_done", 0) - len(found)
    if missing > 0:  # their number is stored with them, in the same transaction
        raise Unreadable(f"{missing} poses of run {run_id} are missing")
    return [pose for pose in found if include_excluded or pose.excluded is None]


def exclude(session: Session, run_id: str, index: int, reason: str, result: Document | None) -> Run:
    """As `Store.exclude_pose`."""
    run = runs.row_of(session, run_id)
    row = session.get(PoseTable, (run.id, index)) if 0 <= index < 2**63 else None
    if row is None:
        raise NotFound(f"run {run_id} has no pose {index}")
    row.excluded_reason, row.excluded_at = reason, datetime.now(UTC)
    runs.set_result(session, run, result)
    return convert.run_of(run)


def packed_samples(session: Session, run_id: str, pose: int | None) -> list[bytes]:
    """The packed blocks of a run in the order stored, or those of one pose's dwell."""
    return packed_blocks(session, [number for number, _ in block_numbers(session, run_id, pose)])


def block_numbers(session: Session, run_id: str, pose: int | None) -> list[tuple[int, int]]:
    """The rows of those blocks, each with how many samples it holds."""
    run = runs.row_of(session, run_id)
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


def packed_blocks(session: Session, numbers: Sequence[int]) -> list[bytes]:
    """The packed blocks of these rows, one after the other."""
    packed: list[bytes] = []
    for first in range(0, len(numbers), VARIABLES):
        some = col(SampleBlockTable.id).in_(numbers[first : first + VARIABLES])
        packed += session.exec(select(SampleBlockTable.data).where(some).order_by(col(SampleBlockTable.id)))
    if len(packed) < len(numbers):
        raise NotFound("raw samples were deleted while they were read")
    return packed


def prune_samples(session: Session, before: datetime) -> int:
    """As `Store.prune_samples`."""
    old = select(RunTable.id).where(RunTable.created_at < before, col(RunTable.status).not_in(UNFINISHED))
    of_old_runs = col(SampleBlockTable.run_id).in_(old)
    count = session.exec(select(func.sum(SampleBlockTable.n_samples)).where(of_old_runs)).one()
    session.execute(delete(SampleBlockTable).where(of_old_runs))
    return int(count or 0)
