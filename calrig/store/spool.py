"""A bench's own store beside a centre: the orders that were acted on, and how far each run was delivered."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Select
from sqlmodel import and_, col, func, or_, select

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
        """Ids of the runs of which something may be left to deliver, the oldest first."""
        wanted = (
            _with_delivery(select(RunTable.uid))
            .where(_is_open())
            .order_by(col(RunTable.created_at), col(RunTable.id))
        )
        with self._database.reading() as session:
            return list(session.scalars(wanted))

    def next_parcels(self, run_id: str) -> list[Parcel]:
        """What a run is to deliver next, in order and not too much of it; empty where nothing is left now."""
        with self._database.reading() as session:
            row = run_row(session, run_id)
            order, before = session.get(TakenOrderTable, run_id), session.get(DeliveryTable, run_id)
            epoch = 1 if order is None else order.epoch  # a run begun here counts as the first order of it
            return next_parcels(session, row, epoch, Delivered() if before is None else _delivered(before))

    def delivered(self, parcels: Sequence[Parcel]) -> None:
        """Keeps that the centre has these, which are all that lay before the last one of each run."""
        with self._database.writing() as session:
            for parcel in parcels:
                after = parcel.after
                session.merge(
                    DeliveryTable(
                        run_uid=parcel.run_id,
                        event_seq=after.event_seq,
                        sample_block_id=after.sample_block_id,
                        is_complete=after.is_complete,
                    )
                )

    def outbox(self) -> Outbox:
        """How much waits to be delivered, and since when."""
        later = EventTable.seq > func.coalesce(DeliveryTable.event_seq, 0)
        events = _with_delivery(select(func.count(), func.min(EventTable.at))).join(
            EventTable, and_(EventTable.run_id == RunTable.id, later)
        )
        beyond = col(SampleBlockTable.id) > func.coalesce(DeliveryTable.sample_block_id, 0)
        blocks = _with_delivery(select(func.count())).join(
            SampleBlockTable, and_(SampleBlockTable.run_id == RunTable.id, beyond)
        )
        with self._database.reading() as session:
            n_events, oldest_at = session.execute(events.where(_is_open())).one()
            n_blocks = session.execute(blocks.where(_is_open())).scalar_one()
        return Outbox(n_events, n_blocks, oldest_at)


def _with_delivery(wanted: Any) -> Select[Any]:
    chosen: Select[Any] = wanted.select_from(RunTable).outerjoin(
        DeliveryTable, col(DeliveryTable.run_uid) == col(RunTable.uid)
    )
    return chosen


def _is_open() -> Any:
    return or_(col(DeliveryTable.run_uid).is_(None), col(DeliveryTable.is_complete).is_(False))


def _delivered(row: DeliveryTable) -> Delivered:
    return Delivered(row.event_seq, row.sample_block_id, row.is_complete)
