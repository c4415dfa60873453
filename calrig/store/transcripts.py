"""What went over the wires before a run failed, inside a transaction that the store has begun."""

from __future__ import annotations

import zlib
from collections.abc import Mapping

from sqlmodel import Session, col, select

from calrig.store import runs
from calrig.store.errors import Unreadable
from calrig.store.tables import TranscriptTable


def keep(session: Session, run_id: str, texts: Mapping[str, str]) -> None:
    """As `Store.keep_transcripts`."""
    run = runs.row_of(session, run_id)
    session.add_all(
        TranscriptTable(run_id=run.id, port=port, data=zlib.compress(text.encode()))
        for port, text in texts.items()
    )


def of_run(session: Session, run_id: str) -> dict[str, str]:
    """As `Store.transcripts`."""
    run = runs.row_of(session, run_id)
    wanted = select(TranscriptTable).where(TranscriptTable.run_id == run.id).order_by(col(TranscriptTable.id))
    try:
        return {row.port: zlib.decompress(row.data).decode() for row in session.exec(wanted)}
    except (zlib.error, UnicodeDecodeError) as error:
        raise Unreadable(f"a transcript cannot be unpacked any more: {error}") from error
