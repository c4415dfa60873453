"""Batches of units: which unit is next, on which rig, and which run each has."""

import uuid
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Literal, cast

from sqlmodel import Session, col, select

from calrig.store.database import Repository, row_of
from calrig.store.errors import ChangedMeanwhile, Refused
from calrig.store.records import Document
from calrig.store.tables import BatchTable, BatchUnitTable

TurnState = Literal["waiting", "follow_up", "running", "done", "failed", "removed"]
"""`follow_up` waits as well: for the run that separates what the one before could not."""


@dataclass(frozen=True, slots=True)
class Turn:
    """A unit's turn in a list; a unit that failed may get another.

    Attributes:
        position: within the list, from 0.
        state: as it was last written; of a run that has ended since, `running`.
        rig: that it is kept for, or was on.
        run_id: its run; of a follow-up that has not begun, the run that it follows.
        why: what a person must know of it.
    """

    position: int
    unit: str
    state: TurnState = "waiting"
    rig: str | None = None
    run_id: str | None = None
    why: str | None = None


@dataclass(frozen=True, slots=True)
class Batch:
    """A list; `document` has its rigs, plan, operator, note, and what becomes of units that failed."""

    id: str
    created_at: datetime
    closed_at: datetime | None
    document: Document
    turns: list[Turn] = field(default_factory=list)


class Batches(Repository):
    """Every list there was."""

    def create(self, document: Document, units: Sequence[str]) -> Batch:
        """Keeps a new list."""
        row = BatchTable(id=str(uuid.uuid4()), created_at=datetime.now(UTC), document=document)
        turns = [Turn(position, unit) for position, unit in enumerate(units)]
        with self._database.writing() as session:
            session.add(row)
            session.flush()
            session.add_all(_row(row.id, turn) for turn in turns)
            return Batch(row.id, row.created_at, None, document, turns)

    def get(self, batch_id: str) -> Batch:
        """One by its id, or NotFound."""
        with self._database.reading() as session:
            return _batch(session, batch_id)

    def newest(self, limit: int = 20) -> list[Batch]:
        """Those made last, the newest first, without their turns."""
        newest_first = select(BatchTable).order_by(col(BatchTable.created_at).desc()).limit(limit)
        with self._database.reading() as session:
            return [
                Batch(row.id, row.created_at, row.closed_at, row.document)
                for row in session.exec(newest_first)
            ]

    def add_units(self, batch_id: str, units: Sequence[str]) -> list[str]:
        """Adds units at the end of an open list; gives those that it has already, whose turn stays as it is.

        One that failed for good gets another turn: who names it again has mended it.

        Raises:
            NotFound: there is no such list.
            Refused: it is closed.
        """
        with self._database.writing() as session:
            batch = _open(session, batch_id)
            last = {turn.unit: turn.state for turn in batch.turns}
            known = {unit for unit, state in last.items() if state not in ("removed", "failed")}
            new = [unit for unit in units if unit not in known]
            first = len(batch.turns)
            session.add_all(_row(batch_id, Turn(first + k, unit)) for k, unit in enumerate(new))
            return [unit for unit in units if unit in known]

    def update(
        self,
        batch_id: str,
        before: Sequence[Turn],
        after: Iterable[Turn],
        closed_at: datetime | None = None,
    ) -> None:
        """Writes what became of turns, unless somebody has written another thing meanwhile.

        `before` is every turn as it was read, `after` those that are new or changed. `closed_at` ends the
        list as of then: nothing of it begins any more; None leaves it open.

        Raises:
            NotFound: there is no such list.
            Refused: it is closed.
            ChangedMeanwhile: it is not as it was.
        """
        with self._database.writing() as session:
            if _open(session, batch_id).turns != list(before):
                raise ChangedMeanwhile("the batch was changed at the same time: reload it and try again")
            for turn in after:
                session.merge(_row(batch_id, turn))
            if closed_at is not None:
                session.get_one(BatchTable, batch_id).closed_at = closed_at


def _open(session: Session, batch_id: str) -> Batch:
    batch = _batch(session, batch_id)
    if batch.closed_at is not None:
        raise Refused("this batch is closed: create another one")
    return batch


def _batch(session: Session, batch_id: str) -> Batch:
    row = row_of(session, BatchTable, batch_id, f"unknown batch {batch_id!r}")
    in_order = select(BatchUnitTable).where(BatchUnitTable.batch == batch_id)
    turns = [
        Turn(one.position, one.unit, cast(TurnState, one.state), one.rig, one.run_uid, one.why)
        for one in session.exec(in_order.order_by(col(BatchUnitTable.position)))
    ]
    return Batch(row.id, row.created_at, row.closed_at, row.document, turns)


def _row(batch_id: str, turn: Turn) -> BatchUnitTable:
    said = asdict(turn)
    return BatchUnitTable(batch=batch_id, run_uid=said.pop("run_id"), **said)
