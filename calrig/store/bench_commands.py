"""What is asked of a bench while somebody waits: stop, abort, pause, resume; and to look at a board."""

from __future__ import annotations

from typing import Literal

from sqlalchemy import delete, update
from sqlmodel import col

from calrig.store.bench_tables import BenchCommandTable, RunOrderTable
from calrig.store.benches import now_there, take_back
from calrig.store.database import Part
from calrig.store.records import Document

Kind = Literal["stop", "abort", "pause", "resume", "look"]


class BenchCommands(Part):
    """Commands to benches. None of these waits for other writers: a stop may not."""

    def ask_bench(self, bench: str, kind: Kind, *, rig: str | None = None, run_uid: str | None = None) -> int:
        """Asks something of a bench; a stop also takes back what waits to begin on the rig.

        A look is asked for every few seconds, and nobody waits for its answer: of each rig the last one is
        kept.

        Returns:
            The command's number.
        """
        with self._database.writing(in_turn=False) as session:
            if kind == "stop":
                of_rig = col(RunOrderTable.bench) == bench, col(RunOrderTable.rig) == rig
                take_back(session, *of_rig)
            if kind == "look":
                before = (
                    col(BenchCommandTable.bench) == bench,
                    col(BenchCommandTable.rig) == rig,
                    col(BenchCommandTable.kind) == kind,
                )
                session.execute(delete(BenchCommandTable).where(*before))
            row = BenchCommandTable(
                bench=bench, kind=kind, rig=rig, run_uid=run_uid, asked_at=now_there(session)
            )
            session.add(row)
            session.flush()
            return row.id

    def answer_of(self, command: int) -> Document | None:
        """What a bench answered: `status` as of HTTP, and `detail`; None before it has."""
        with self._database.reading() as session:
            row = session.get(BenchCommandTable, command)
            return None if row is None or row.answered_at is None else row.answer or {}

    def withdraw_command(self, command: int) -> bool:
        """Takes a command back that its bench has not taken; returns whether it did."""
        withdrawn = (
            update(BenchCommandTable)
            .where(
                col(BenchCommandTable.id) == command,
                col(BenchCommandTable.taken_at).is_(None),
                col(BenchCommandTable.withdrawn_at).is_(None),
            )
            .returning(col(BenchCommandTable.id))
            .execution_options(synchronize_session=False)
        )
        with self._database.writing(in_turn=False) as session:
            now = now_there(session)
            return session.execute(withdrawn.values(withdrawn_at=now)).first() is not None
