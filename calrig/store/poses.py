"""Poses and their raw samples, inside a transaction that the store has begun."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from sqlmodel import Session, col, delete, func, insert, select

from calrig.calibration.pose import Pose
from calrig.store import convert, runs
from calrig.store.errors import NotFound
from calrig.store.records import UNFINISHED, Document, Run, SampleBlock, StoredPose
from calrig.store.tables import PoseTable, RunTable, SampleBlockTable


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
    if not include_excluded:
        wanted = wanted.where(col(PoseTable.excluded_reason).is_(None))
    return [convert.pose_of(pose) for pose in session.exec(wanted)]


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
    run = runs.row_of(session, run_id)
    wanted = (
        select(SampleBlockTable.data)
        .where(SampleBlockTable.run_id == run.id)
        .order_by(col(SampleBlockTable.id))
    )
    if pose is not None:
        known = pose == 0 if run.kind == "static" else session.get(PoseTable, (run.id, min(pose, 2**62)))
        if pose < 0 or not known:
            raise NotFound(f"run {run_id} has no pose {pose}")
        wanted = wanted.where(SampleBlockTable.pose_index == pose, SampleBlockTable.phase == "dwell")
    return list(session.exec(wanted))


def prune_samples(session: Session, before: datetime) -> int:
    """As `Store.prune_samples`."""
    old = select(RunTable.id).where(RunTable.created_at < before, col(RunTable.status).not_in(UNFINISHED))
    of_old_runs = col(SampleBlockTable.run_id).in_(old)
    count = session.exec(select(func.sum(SampleBlockTable.n_samples)).where(of_old_runs)).one()
    session.execute(delete(SampleBlockTable).where(of_old_runs))
    return int(count or 0)
