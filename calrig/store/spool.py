"""A bench's own store beside a centre: the orders that were acted on, and how far each run was delivered."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import NamedTuple

from sqlmodel import Session, col, func, or_, select

from calrig.store.bench_tables import DeliveryTable, TakenOrderTable
from calrig.store.convert import run_row
from calrig.store.database import Part
from calrig.store.packing import EVENTS_A_PARCEL, Delivered, Parcel, next_parcels
from calrig.store.records import Document
from calrig.store.tables import EventTable, RunTable, SampleBlockTable


class TakenOrder(NamedTuple):
    """The newest epoch of a run that the bench has acted on, and what was ordered."""

    epoch: int
    document: Document


@dataclass(frozen=True, slots=True)
class Outbox:
    """What has not been delivered: events and blocks of samples, and when the oldest event was announced."""

    n_events: int
    n_blocks: int
    oldest_at: datetime | None

    @property
    def n_parcels(self) -> int:
        """About as many pieces."""
        return math.ceil(self.n_events / EVENTS_A_PARCEL) + self.n_blocks


class Spool(Part):
    """What a bench keeps of its dealings with the centre."""

    def take_order(self, run_id: str, epoch: int, document: Document) -> None:
        """Keeps that an order is being acted on."""
        with self._database.writing() as session:
            session.merge(TakenOrderTable(run_uid=run_id, epoch=epoch, document=document))

    def taken_order(self, run_id: str) -> TakenOrder | None:
        """The newest order of a run that was acted on; None of a run that was begun here."""
        with self._database.reading() as session:
            row = session.get(TakenOrderTable, run_id)
            return None if row is None else TakenOrder(row.epoch, row.document)

    def taken_epochs(self) -> dict[str, int]:
        """The newest epoch that was acted on, of each run that was ordered."""
        with self._database.reading() as session:
            return dict(session.exec(select(TakenOrderTable.run_uid, TakenOrderTable.epoch)).all())

    def undelivered(self) -> list[str]:
        """Ids of the runs of which something may be left to deliver, in the order they came here."""
        with self._database.reading() as session:
            return [run.uid for run in _open_runs(session)]

    def next_parcels(self, run_id: str) -> list[Parcel]:
        """What a run is to deliver next, in order and not too much of it; empty where nothing is left now."""
        with self._database.reading() as session:
            row = run_row(session, run_id)
            order, before = session.get(TakenOrderTable, run_id), session.get(DeliveryTable, run_id)
            epoch = 1 if order is None else order.epoch  # a run begun here counts as the first order of it
            return next_parcels(session, row, epoch, Delivered() if before is None else _delivered(before))

    def delivered(self, parcels: Sequence[Parcel]) -> None:
        """Keeps that the centre has these, which are all that lay before the last one of each run."""
        last = {parcel.run_id: parcel.after for parcel in parcels}
        with self._database.writing() as session:
            for run_id, after in last.items():
                session.merge(DeliveryTable(run_uid=run_id, **asdict(after)))

    def outbox(self) -> Outbox:
        """How much waits to be delivered, and since when."""
        n_events, n_blocks, waiting_since = 0, 0, []
        with self._database.reading() as session:
            for run in _open_runs(session):
                later = EventTable.run_id == run.id, EventTable.seq > (run.event_seq or 0)
                n, oldest_at = session.exec(select(func.count(), func.min(EventTable.at)).where(*later)).one()
                beyond = SampleBlockTable.run_id == run.id, SampleBlockTable.id > (run.sample_block_id or 0)
                n_events += n
                n_blocks += session.exec(select(func.count()).where(*beyond)).one()
                if oldest_at is not None:
                    waiting_since.append(oldest_at)
        return Outbox(n_events, n_blocks, min(waiting_since, default=None))


class _OpenRun(NamedTuple):
    """A run that is not known to be delivered whole."""

    id: int
    uid: str
    event_seq: int | None
    sample_block_id: int | None


def _open_runs(session: Session) -> list[_OpenRun]:
    """Every such run, in the order they came here; it is asked for often, and so read from indices alone."""
    wanted = (
        select(RunTable.id, RunTable.uid, DeliveryTable.event_seq, DeliveryTable.sample_block_id)
        .outerjoin(DeliveryTable, col(DeliveryTable.run_uid) == col(RunTable.uid))
        .where(or_(col(DeliveryTable.run_uid).is_(None), col(DeliveryTable.is_complete).is_(False)))
    )
    return sorted(_OpenRun(*row) for row in session.exec(wanted))


def _delivered(row: DeliveryTable) -> Delivered:
    return Delivered(row.event_seq, row.sample_block_id, row.is_complete)
