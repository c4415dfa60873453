"""Making, finding and changing runs, inside a transaction that the store has begun."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime

from sqlmodel import Session, col, insert, select

from calrig.calibration.pose import Pose
from calrig.store import convert, event_log
from calrig.store.errors import NotFound
from calrig.store.records import TERMINAL, UNFINISHED, Document, Run, RunChanges, Status
from calrig.store.tables import CalibrationTable, PoseTable, RunTable, UnitTable

POSES_AT_ONCE = 1000
"""Handed to SQLite together: an import has a hundred thousand."""


def number(run_id: str) -> int | None:
    """The row that an id stands for; None where no run could ever have it."""
    return int(run_id) if re.fullmatch(r"[1-9][0-9]{0,17}", run_id, re.ASCII) else None


def find(session: Session, run_id: str) -> Run | None:
    """As `Store.run`."""
    row = session.get(RunTable, number(run_id) or 0)
    return None if row is None else convert.run_of(row)


def row_of(session: Session, run_id: str) -> RunTable:
    """The row of a run that must be there."""
    row = session.get(RunTable, number(run_id) or 0)
    if row is None:
        raise NotFound(f"there is no run {run_id}")
    return row


def create(
    session: Session,
    *,
    unit: str,
    rig: str | None,
    plan: Document | None,
    status: Status,
    provenance: Document,
    operator: str | None,
    note: str | None,
    follows: str | None,
    poses_total: int,
    poses: Sequence[Pose],
    result: Document | None,
) -> Run:
    """As `Store.create_run`."""
    now = datetime.now(UTC)
    total = max(poses_total, len(poses))
    if session.get(UnitTable, unit) is None:
        session.add(UnitTable(serial=unit, created_at=now))
        session.flush()
    row = RunTable(
        unit=unit,
        rig=rig,
        kind=(plan or {}).get("kind", "calibration"),
        status=status,
        plan=plan,
        progress={
            "poses_done": len(poses),
            "poses_total": total,
            "fraction": len(poses) / total if total else 0.0,
            "remaining_s": 0.0 if status in TERMINAL else None,
        },
        faults={},
        follows=None if follows is None else row_of(session, follows).id,
        provenance=provenance,
        operator=operator,
        note=note,
        created_at=now,
    )
    _stamp(row, now)
    session.add(row)
    session.flush()
    for first in range(0, len(poses), POSES_AT_ONCE):
        some = enumerate(poses[first : first + POSES_AT_ONCE], start=first)
        session.execute(insert(PoseTable), [convert.pose_values(row.id, index, pose) for index, pose in some])
    set_result(session, row, result)
    event_log.append(session, row, [event_log.state(row)])
    return convert.run_of(row)


def page(
    session: Session,
    *,
    unit: str | None,
    rig: str | None,
    status: str | None,
    limit: int,
    cursor: str | None,
) -> tuple[list[Run], str | None]:
    """As `Store.runs`."""
    if limit < 1:
        raise ValueError(f"limit is {limit}; a page holds at least 1 run")
    wanted = select(RunTable).order_by(col(RunTable.id).desc()).limit(limit + 1)
    for column, value in ((RunTable.unit, unit), (RunTable.rig, rig), (RunTable.status, status)):
        if value is not None:
            wanted = wanted.where(column == value)
    if cursor is not None:
        before = number(cursor)
        if before is None:
            raise ValueError(f"cursor {cursor!r} is not one that this list gave")
        wanted = wanted.where(col(RunTable.id) < before)
    found = [convert.run_of(row) for row in session.exec(wanted)]
    return found[:limit], found[limit - 1].id if len(found) > limit else None


def update(session: Session, run_id: str, events: Sequence[event_log.Announced], changes: RunChanges) -> Run:
    """As `Store.update_run`."""
    row = row_of(session, run_id)
    change(session, row, events, changes)
    return convert.run_of(row)


def change(
    session: Session, row: RunTable, events: Sequence[event_log.Announced], changes: RunChanges
) -> list[int]:
    """Makes the changes, announces `events` and then, where a status was given, the new state."""
    unknown = changes.keys() - RunChanges.__annotations__.keys()
    if unknown:
        raise TypeError(f"a run has no {', '.join(sorted(unknown))} to change")
    for name, value in changes.items():
        if name != "result":
            setattr(row, name, value)
    if "result" in changes:
        set_result(session, row, changes["result"])
    state = []
    if "status" in changes:
        _stamp(row, datetime.now(UTC))
        state = [event_log.state(row)]
    return event_log.append(session, row, [*events, *state])


def unfinished(session: Session) -> list[Run]:
    """As `Store.unfinished`."""
    wanted = select(RunTable).where(col(RunTable.status).in_(UNFINISHED)).order_by(col(RunTable.id))
    return [convert.run_of(row) for row in session.exec(wanted)]


def void(session: Session, run_id: str, reason: str) -> Run:
    """As `Store.void_run`."""
    row = row_of(session, run_id)
    row.voided_reason, row.voided_at = reason, datetime.now(UTC)
    return convert.run_of(row)


def _stamp(row: RunTable, now: datetime) -> None:
    if row.status in {"running", "completed"} and row.started_at is None:
        row.started_at = now
    row.finished_at = now if row.status in TERMINAL else None


def set_result(session: Session, row: RunTable, result: Document | None) -> None:
    """Gives a run its result and the figures that stand for it in comparisons."""
    row.result = result
    figures = session.get(CalibrationTable, row.id)
    if figures is not None:
        session.delete(figures)
        session.flush()
    if result is not None:
        session.add(convert.figures_of(row.id, result))
