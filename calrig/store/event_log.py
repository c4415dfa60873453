"""Events of runs as published, and transcripts of the ports of failed runs."""

import zlib
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlmodel import Session, col, func, insert, select

from calrig.store.convert import check_texts, run_row
from calrig.store.database import Repository
from calrig.store.errors import Unreadable
from calrig.store.records import Event
from calrig.store.tables import EventTable, RunTable, TranscriptTable

Announced = tuple[str, Mapping[str, Any]]
"""An event's type and data."""


class EventLog(Repository):
    """Events and transcripts of runs."""

    def append(self, run_id: str, events: Sequence[Announced]) -> list[int]:
        """Appends events to a run's log; returns their numbers in it, from 1 and without gaps."""
        with self._database.writing() as session:
            return append(session, run_row(session, run_id), events)

    def after(self, run_id: str, seq: int = 0, limit: int = 1000) -> list[Event]:
        """At most `limit` events that follow number `seq`, in order."""
        with self._database.reading() as session:
            run = run_row(session, run_id)
            wanted = (
                select(EventTable)
                .where(EventTable.run_id == run.id, EventTable.seq > seq)
                .order_by(col(EventTable.seq))
                .limit(limit)
            )
            rows = session.exec(wanted).all()
            check_texts((row.type for row in rows), f"the log of run {run.uid}")
            found = [Event(seq=row.seq, type=row.type, data=row.data) for row in rows]
            for expected, event in enumerate(found, start=seq + 1):
                if event.seq != expected:
                    raise Unreadable(f"event {expected} of run {run.uid} is missing")
            return found

    def poses_announced_at(self, run_id: str) -> dict[int, datetime]:
        """When each pose of a run was announced, by its index: on the clock of the machine that took it."""
        with self._database.reading() as session:
            run = run_row(session, run_id)
            wanted = select(EventTable).where(EventTable.run_id == run.id, EventTable.type == "pose")
            return {int(row.data["index"]): row.at for row in session.exec(wanted)}

    def save_transcripts(self, run_id: str, texts: Mapping[str, str]) -> None:
        """Keeps what went over each port of a run."""
        with self._database.writing() as session:
            run = run_row(session, run_id)
            session.add_all(
                TranscriptTable(run_id=run.id, port=port, data=zlib.compress(text.encode()))
                for port, text in texts.items()
            )

    def transcripts(self, run_id: str) -> dict[str, str]:
        """What went over each port in the last minute before the run failed; empty where it did not."""
        with self._database.reading() as session:
            return transcripts_of(session, run_row(session, run_id))


def transcripts_of(session: Session, run: RunTable) -> dict[str, str]:
    """As `EventLog.transcripts`, of a session."""
    wanted = select(TranscriptTable).where(TranscriptTable.run_id == run.id).order_by(col(TranscriptTable.id))
    try:
        return {row.port: zlib.decompress(row.data).decode() for row in session.exec(wanted)}
    except (zlib.error, UnicodeDecodeError) as error:
        raise Unreadable(f"a transcript cannot be unpacked any more: {error}") from error


def append(session: Session, run: RunTable, events: Sequence[Announced]) -> list[int]:
    """Appends events under the next numbers, inside a transaction that somebody else has begun."""
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
