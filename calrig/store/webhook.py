"""Ends of runs to be reported to another program, stored until delivered or given up."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlmodel import col, func, select, update

from calrig.model.run import TERMINAL
from calrig.store.database import Repository
from calrig.store.tables import RunTable, WebhookDeliveryTable

LONGEST_RUN = timedelta(days=30)
"""Of runs that ended while nobody took them in, those made longer ago are not looked for."""


@dataclass(frozen=True, slots=True)
class Delivery:
    """The end of a run that is to be told; `tries` were made before."""

    run_id: str
    due_at: datetime
    tries: int


class Deliveries(Repository):
    """One a run. Other programs over the same database deliver from the same rows: each is taken by one."""

    def record_end(self, run_id: str, now: datetime) -> bool:
        """Takes the end of a run in, once; False where it has not ended, or was taken in before."""
        with self._database.writing() as session:
            if session.get(WebhookDeliveryTable, run_id) is not None:
                return False
            wanted = select(RunTable.status, RunTable.finished_at).where(RunTable.uid == run_id)
            found = session.exec(wanted).first()
            if found is None or found[0] not in TERMINAL:
                return False
            session.add(WebhookDeliveryTable(run_uid=run_id, ended_at=found[1] or now, due_at=now, tries=0))
            return True

    def unrecorded_ends(self) -> list[str]:
        """Runs that ended since the last end that was taken in: the program died between the two.

        None where no end was ever taken in: before, nobody was to be told.
        """
        with self._database.reading() as session:
            last = session.exec(select(func.max(WebhookDeliveryTable.ended_at))).one()
            if last is None:
                return []
            since = datetime.fromisoformat(last) if isinstance(last, str) else last
            wanted = (
                select(RunTable.uid)
                .where(
                    col(RunTable.status).in_(TERMINAL),
                    col(RunTable.created_at) > since - LONGEST_RUN,
                    col(RunTable.finished_at) > since,
                    col(RunTable.plan).is_not(None),
                )
                .order_by(col(RunTable.finished_at))
            )
            return list(session.exec(wanted))

    def next(self) -> Delivery | None:
        """The one that is due first, which may be later."""
        due = select(WebhookDeliveryTable).where(col(WebhookDeliveryTable.due_at).is_not(None))
        with self._database.reading() as session:
            row = session.exec(due.order_by(col(WebhookDeliveryTable.due_at)).limit(1)).first()
            return None if row is None or row.due_at is None else Delivery(row.run_uid, row.due_at, row.tries)

    def claim(self, delivery: Delivery, until: datetime) -> bool:
        """Keeps it from other programs until then; False where one of them was first."""
        taken = (
            update(WebhookDeliveryTable)
            .where(
                col(WebhookDeliveryTable.run_uid) == delivery.run_id,
                col(WebhookDeliveryTable.due_at) == delivery.due_at,
            )
            .values(due_at=until)
            .returning(col(WebhookDeliveryTable.run_uid))
        )
        with self._database.writing() as session:
            return session.execute(taken).first() is not None

    def settle(self, delivery: Delivery, error: str | None, again_at: datetime | None) -> None:
        """What came of a try: delivered, where there is no error; else tried again then, or never."""
        with self._database.writing() as session:
            row = session.get_one(WebhookDeliveryTable, delivery.run_id)
            row.tries = delivery.tries + 1
            row.error, row.due_at = error, again_at
            row.delivered_at = None if error else datetime.now(UTC)

    def count_waiting(self) -> int:
        """How many there are to be made."""
        waiting = select(func.count()).where(col(WebhookDeliveryTable.due_at).is_not(None))
        with self._database.reading() as session:
            return session.exec(waiting).one()
