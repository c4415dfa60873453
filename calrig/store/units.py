"""Units: the list, the comparison of their calibrations, and the item as received from the customer."""

from collections.abc import Sequence
from datetime import UTC, date, datetime
from typing import Any, Literal

import sqlalchemy
from sqlmodel import Session, col, delete, func, select

from calrig.model.base import Model
from calrig.store.checksums import check_numbers
from calrig.store.convert import FIGURES, result_part
from calrig.store.database import Repository, row_of
from calrig.store.errors import Refused
from calrig.store.records import ComparisonRow, Unit
from calrig.store.runs import VALID_CALIBRATION
from calrig.store.tables import (
    AcceptedEffectTable,
    CalibrationTable,
    CertificateTable,
    CheckUnitTable,
    IssuedCalibrationTable,
    ItemTable,
    RunTable,
    UnitTable,
    UtcText,
)
from calrig.store.trail import Act, append

_COMPARED: tuple[Any, ...] = (
    RunTable.unit,
    RunTable.uid,
    RunTable.rig,
    RunTable.finished_at,
    *(getattr(CalibrationTable, name) for name in FIGURES),
    CalibrationTable.crc32,
)
"""In the order of `ComparisonRow`; columns, not objects of the tables: thousands come in milliseconds."""


_KEPT_OF_UNITS: dict[Any, str] = {
    RunTable: "runs",
    CheckUnitTable: "a rig that is checked by it",
    AcceptedEffectTable: "effects that were accepted",
    CertificateTable: "certificates",
}
"""What keeps a unit from being removed."""


class Units(Repository):
    """What is known about units over their runs."""

    def all(self, serials: Sequence[str] | None = None) -> list[Unit]:
        """Units by serial number, every one or those of some serials."""
        with self._database.reading() as session:
            return _units(session, serials)

    def count(self) -> int:
        """How many units there are."""
        with self._database.reading() as session:
            return session.exec(select(func.count()).select_from(UnitTable)).one()

    def get(self, serial: str) -> Unit | None:
        """The unit, or None."""
        with self._database.reading() as session:
            return next(iter(_units(session, [serial])), None)

    def comparison(
        self, serials: Sequence[str] | None = None, *, latest: int | None = None
    ) -> list[ComparisonRow]:
        """The figures of every calibration that counts, by unit, the oldest of each first.

        That is: completed and not voided; no verification, static log or follow-up.

        Of all units without `serials`; with `latest`, so many made last, of whichever units, are told as
        well.
        """
        wanted = (
            sqlalchemy.select(*_COMPARED)
            .join(CalibrationTable, col(CalibrationTable.run_id) == RunTable.id)
            .where(*VALID_CALIBRATION, col(RunTable.follows).is_(None))
        )
        in_order = col(RunTable.unit), col(RunTable.finished_at), col(RunTable.id)
        with self._database.reading() as session:

            def found(which: sqlalchemy.Select[Any]) -> list[ComparisonRow]:
                return [_compared(row) for row in session.connection().execute(which)]

            if serials is None:
                return found(wanted.order_by(*in_order))
            rows = found(wanted.where(col(RunTable.unit).in_(serials)).order_by(*in_order))
            if latest is None:
                return rows
            newest = wanted.order_by(col(RunTable.created_at).desc(), col(RunTable.id).desc()).limit(latest)
            known = {row.run_id for row in rows}
            rows += [row for row in reversed(found(newest)) if row.run_id not in known]
        return sorted(rows, key=lambda row: (row.unit, row.finished_at))

    def remove(self, serial: str, *, who: str | None = None) -> None:
        """Removes a unit that nothing is known of.

        Raises:
            NotFound: there is no such unit.
            Refused: it has runs or a calibration in force, or a rig is checked by it.
        """
        with self._database.writing() as session:
            row = row_of(session, UnitTable, serial, f"there is no unit {serial!r}")
            for table, kept in _KEPT_OF_UNITS.items():
                if session.exec(select(table).where(table.unit == serial).limit(1)).first() is not None:
                    raise Refused(f"unit {serial!r} has {kept} and is not removed")
            _remove_revisions(session, serial)
            session.exec(delete(ItemTable).where(col(ItemTable.unit) == serial))
            session.delete(row)
            append(session, Act("unit_removed", who=who, unit=serial))


def _remove_revisions(session: Session, serial: str) -> None:
    """All of a unit that is none. The trail keeps their hashes."""
    wanted = select(IssuedCalibrationTable).where(IssuedCalibrationTable.unit == serial)
    for row in session.exec(wanted).all():
        if row.status == "in_force":
            said = (
                f"revision {row.revision} of unit {serial!r} is in force: withdraw it first, with the reason"
            )
            raise Refused(said)
        session.delete(row)
    session.flush()


def _units(session: Session, serials: Sequence[str] | None = None) -> list[Unit]:
    wanted = (
        select(UnitTable, func.count(col(RunTable.id)), func.max(RunTable.created_at, type_=UtcText()))
        .join(RunTable, isouter=True)
        .group_by(col(UnitTable.serial))
        .order_by(col(UnitTable.serial))
    )
    if serials is not None:
        wanted = wanted.where(col(UnitTable.serial).in_(serials))
    return [
        Unit(serial=unit.serial, created_at=unit.created_at, n_runs=n_runs, last_run_at=last)
        for unit, n_runs, last in session.exec(wanted)
    ]


def _compared(row: Sequence[Any]) -> ComparisonRow:
    unit, run_id, rig, finished_at, *figures, crc32 = row
    check_numbers(crc32, figures, f"the figures of run {run_id}")
    return ComparisonRow(unit, run_id, rig, finished_at, result_part(figures))


ItemField = Literal[
    "customer", "address", "order", "received_at", "condition", "description", "interval_agreed_months"
]


class CalibrationItem(Model):
    """A unit as it was handed in; null where nobody has said.

    `order` is the customer's number, `condition` as seen at receipt. `interval_agreed_months` is until the
    next calibration, where the customer agreed to one; `supplied` names the fields the customer supplied.
    """

    customer: str | None = None
    address: str | None = None
    order: str | None = None
    received_at: date | None = None
    condition: str | None = None
    description: str | None = None
    interval_agreed_months: int | None = None
    supplied: tuple[ItemField, ...] = ()


class Items(Repository):
    """What was said of units as they came."""

    def of(self, unit: str, day: date | None = None) -> CalibrationItem | None:
        """What was said of a unit last; with a day, of those received by then. None where nobody did."""
        wanted = select(ItemTable).where(ItemTable.unit == unit).order_by(col(ItemTable.id).desc())
        with self._database.reading() as session:
            for row in session.exec(wanted):
                item = CalibrationItem.model_validate(row.document)
                if day is None or item.received_at is None or item.received_at <= day:
                    return item
        return None

    def add(self, unit: str, item: CalibrationItem, *, who: str | None) -> None:
        """Adds what somebody says of a unit, and puts it into the trail.

        Raises:
            NotFound: there is no such unit.
        """
        with self._database.writing() as session:
            row_of(session, UnitTable, unit, f"there is no unit {unit!r}: a unit appears with its first run")
            said = item.model_dump(mode="json")
            session.add(ItemTable(unit=unit, document=said, at=datetime.now(UTC)))
            append(session, Act("item_changed", who=who, unit=unit, detail=said))
