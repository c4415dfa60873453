"""The event log of a run, inside a transaction that somebody else has begun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlmodel import Session, col, func, insert, select

from calrig.store.errors import Unreadable
from calrig.store.records import Event
from calrig.store.tables import EventTable, RunTable

Announced = tuple[str, Mapping[str, Any]]
"""An event's type and data."""


def append(session: Session, run: RunTable, events: Sequence[Announced]) -> list[int]:
    """Appends events under the next numbers."""
    if not events:
        return []
    last = session.exec(select(func.max(EventTable.seq)).where(EventTable.run_id == run.id)).one() or 0
    now = datetime.now(UTC)
    rows: list[dict[str, Any]] = [
        {"run_id": run.id, "seq": seq, "type": kind, "data": data, "at": now}
        for seq, (kind, data) in enumerate(events, start=last + 1)
    ]
    session.execute(insert(EventTable), rows)
    return [row["seq"] for row in rows]


def state(run: RunTable) -> Announced:
    """The event that announces a run's state."""
    return "state", {"status": run.status, "error": run.error}


def after(session: Session, run: RunTable, seq: int, limit: int) -> list[Event]:
    """The events that follow number `seq`, in order."""
    wanted = (
        select(EventTable)
        .where(EventTable.run_id == run.id, EventTable.seq > seq)
        .order_by(col(EventTable.seq))
        .limit(limit)
    )
    found = [Event(seq=row.seq, type=row.type, data=row.data) for row in session.exec(wanted)]
    for expected, event in enumerate(found, start=seq + 1):
        if event.seq != expected:
            raise Unreadable(f"event {expected} of run {run.id} is missing")
    return found
