"""What lies between a centre and its benches: orders, deliveries and commands that nobody has seen to yet."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import NamedTuple

from sqlmodel import col, func, select

from calrig.store.bench_tables import BenchCommandTable, ParcelTable, RunOrderTable
from calrig.store.benches import NOT_TAKEN, now_there
from calrig.store.database import Part
from calrig.store.tables import RunTable

RECENT = timedelta(hours=1)
"""Commands are for now: one that found nobody days ago is no trouble of today."""
IN_TIME = timedelta(seconds=5)
"""Within which a bench answers."""


class Waiting(NamedTuple):
    """How many, and the age of the oldest by the database's clock."""

    number: int
    age_s: float


@dataclass(frozen=True, slots=True)
class Backlog:
    """What waits.

    Attributes:
        orders: not taken, by bench and rig.
        parcels: not unpacked, by bench.
        unanswered: commands within the last hour that their bench did not answer in time, by bench.
    """

    orders: dict[tuple[str, str], Waiting] = field(default_factory=dict)
    parcels: dict[str, Waiting] = field(default_factory=dict)
    unanswered: dict[str, int] = field(default_factory=dict)


class BenchBacklog(Part):
    """Of all benches."""

    def backlog(self) -> Backlog:
        """In one state of the store. Whatever waits to be taken is of a queued run: those are few."""
        orders = (
            select(RunOrderTable.bench, RunOrderTable.rig, func.count(), func.min(RunOrderTable.ordered_at))
            .join(RunTable, col(RunTable.uid) == col(RunOrderTable.run_uid))
            .where(RunTable.status == "queued", NOT_TAKEN)
            .group_by(col(RunOrderTable.bench), col(RunOrderTable.rig))
        )
        parcels = select(ParcelTable.bench, func.count(), func.min(ParcelTable.delivered_at)).group_by(
            col(ParcelTable.bench)
        )
        commands = select(BenchCommandTable.bench, func.count()).group_by(col(BenchCommandTable.bench))
        with self._database.reading() as session:
            now = now_there(session)
            unanswered = commands.where(
                col(BenchCommandTable.answered_at).is_(None),
                col(BenchCommandTable.asked_at) > now - RECENT,
                col(BenchCommandTable.asked_at) < now - IN_TIME,
            )
            return Backlog(
                {(bench, rig): _waiting(n, at, now) for bench, rig, n, at in session.exec(orders)},
                {bench: _waiting(n, at, now) for bench, n, at in session.exec(parcels)},
                dict(session.exec(unanswered).all()),
            )


def _waiting(number: int, oldest_at: datetime, now: datetime) -> Waiting:
    return Waiting(number, max(0.0, (now - oldest_at).total_seconds()))
