"""Units over their runs: the list, the comparison, the calibration in force and the accepted effects.

What the customer said of a unit: whose it is, when and how it came. Entries are added, none is changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, date, datetime
from typing import Any

import sqlalchemy
from sqlmodel import Session, col, delete, func, or_, select

from calrig.model.plan import CALIBRATING
from calrig.store.checksums import check_numbers
from calrig.store.convert import FIGURES, result_part, run_of
from calrig.store.database import Part
from calrig.store.errors import NotFound, Refused
from calrig.store.records import AcceptedEffect, ComparisonRow, Run, Unit
from calrig.store.tables import (
    AcceptedEffectTable,
    CalibrationTable,
    CheckUnitTable,
    IssuedCalibrationTable,
    ItemTable,
    RunTable,
    UnitTable,
    UtcText,
)
from calrig.store.trail import Act, append

COUNTS = (
    col(RunTable.status) == "completed",
    col(RunTable.kind).in_(CALIBRATING),
    col(RunTable.voided_reason).is_(None),
)
"""Of a run that makes a calibration; a follow-up does not, whose `follows` is set."""

_AT_ONCE = 500
"""Runs asked for by their ids in one question."""
_STANDS = col(AcceptedEffectTable.withdrawn_at).is_(None)

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
}
"""What keeps a unit from being removed."""


class Units(Part):
    """What is known about units over their runs."""

    def units(self, serials: Sequence[str] | None = None) -> list[Unit]:
        """Units by serial number, every one or those of some serials."""
        with self._database.reading() as session:
            return _units(session, serials)

    def unit(self, serial: str) -> Unit | None:
        """The unit, or None."""
        with self._database.reading() as session:
            return next(iter(_units(session, [serial])), None)

    def comparison(
        self, serials: Sequence[str] | None = None, *, latest: int | None = None
    ) -> list[ComparisonRow]:
        """The figures of every calibration that counts, by unit, the oldest of each first.

        That is: completed and not voided; no verification, static log or follow-up.

        Args:
            serials: the units to compare; None for all.
            latest: so many of those made last, of whichever units, are told as well.
        """
        wanted = (
            sqlalchemy.select(*_COMPARED)
            .join(CalibrationTable, col(CalibrationTable.run_id) == RunTable.id)
            .where(*COUNTS, col(RunTable.follows).is_(None))
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

    def reference_figures(self, run_ids: Sequence[str]) -> dict[str, tuple[float, float | None]]:
        """What the stage is worth in the bias (deg) and scale of runs that know it: type B, by run."""
        found: dict[str, tuple[float, float | None]] = {}
        with self._database.reading() as session:
            for begin in range(0, len(run_ids), _AT_ONCE):
                some = run_ids[begin : begin + _AT_ONCE]
                wanted = select(RunTable.uid, RunTable.result).where(col(RunTable.uid).in_(some))
                for run_id, result in session.exec(wanted):
                    reference = (result or {}).get("reference")
                    if reference is not None:
                        found[run_id] = (reference["bias_std_deg"], reference["scale_std"])
        return found

    def latest_calibration_run(self, serial: str, *, follow_ups: bool = False) -> Run | None:
        """The latest completed, not voided calibration (or import) whose scale is known, or None.

        `follow_ups` counts those as well, as stores did before there were revisions.
        """
        wanted = (
            select(RunTable)
            .join(CalibrationTable)
            .where(RunTable.unit == serial, *COUNTS, col(CalibrationTable.scale).is_not(None))
            .order_by(col(RunTable.finished_at).desc(), col(RunTable.id).desc())
            .limit(1)
        )
        if not follow_ups:
            wanted = wanted.where(col(RunTable.follows).is_(None))
        with self._database.reading() as session:
            row = session.exec(wanted).first()
            return None if row is None else run_of(row)

    def remove_unit(self, serial: str, *, who: str | None = None) -> None:
        """Removes a unit that nothing is known of.

        Raises:
            NotFound: there is no such unit.
            Refused: it has runs or a calibration in force, or a rig is checked by it.
        """
        with self._database.writing() as session:
            row = session.get(UnitTable, serial)
            if row is None:
                raise NotFound(f"there is no unit {serial!r}")
            for table, kept in _KEPT_OF_UNITS.items():
                if session.exec(select(table).where(table.unit == serial).limit(1)).first() is not None:
                    raise Refused(f"unit {serial!r} has {kept} and is not removed")
            _remove_revisions(session, serial)
            session.exec(delete(ItemTable).where(col(ItemTable.unit) == serial))
            session.delete(row)
            append(session, Act("unit_removed", who=who, unit=serial))

    def effects_in_force(self, unit: str, rig: str | None) -> list[AcceptedEffect]:
        """The effects accepted for a unit and for a rig: of each name the latest that was not taken back."""
        wanted = (
            select(AcceptedEffectTable, RunTable.uid)
            .join(RunTable)
            .where(or_(AcceptedEffectTable.unit == unit, col(AcceptedEffectTable.rig) == (rig or "")))
            .where(_STANDS)
            .order_by(col(AcceptedEffectTable.id))
        )
        with self._database.reading() as session:
            latest = {(row.unit, row.name): _accepted(row, run_id) for row, run_id in session.exec(wanted)}
        return list(latest.values())

    def accepted_effects(self, ids: Sequence[int]) -> list[AcceptedEffect]:
        """Effects that were accepted, by their ids, those that were taken back since among them."""
        found = []
        with self._database.reading() as session:
            for first in range(0, len(ids), _AT_ONCE):
                some = col(AcceptedEffectTable.id).in_(ids[first : first + _AT_ONCE])
                wanted = select(AcceptedEffectTable, RunTable.uid).join(RunTable).where(some)
                in_order = wanted.order_by(col(AcceptedEffectTable.id))
                found += [_accepted(row, run_id) for row, run_id in session.exec(in_order)]
        return found

    def effect_names(self) -> dict[str, list[str]]:
        """Names of the effects in force for each unit that has any."""
        wanted = (
            select(AcceptedEffectTable.unit, AcceptedEffectTable.name)
            .where(col(AcceptedEffectTable.unit).is_not(None), _STANDS)
            .distinct()
            .order_by(col(AcceptedEffectTable.unit), col(AcceptedEffectTable.name))
        )
        found: dict[str, list[str]] = {}
        with self._database.reading() as session:
            for unit, name in session.exec(wanted):
                found.setdefault(str(unit), []).append(name)
        return found


def _accepted(row: AcceptedEffectTable, run_id: str) -> AcceptedEffect:
    return AcceptedEffect(
        run_id=run_id,
        unit=row.unit,
        rig=row.rig,
        name=row.name,
        origin=row.origin,
        parameters=row.parameters,
        id=row.id,
    )


def _remove_revisions(session: Session, serial: str) -> None:
    """All of a unit that is none. The trail keeps their hashes.

    Raises:
        Refused: one is in force.
    """
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
    """All units by serial, or some."""
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


@dataclass(frozen=True, slots=True)
class CalibrationItem:
    """A unit as it was handed in; None where nobody has said.

    Attributes:
        order: the customer's number.
        condition: in which it came, as seen at receipt.
        interval_agreed_months: until the next calibration, where the customer agreed to one.
        supplied: names of these fields that the customer supplied.
    """

    customer: str | None = None
    address: str | None = None
    order: str | None = None
    received_at: date | None = None
    condition: str | None = None
    description: str | None = None
    interval_agreed_months: int | None = None
    supplied: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        received = None if self.received_at is None else self.received_at.isoformat()
        return {**asdict(self), "received_at": received, "supplied": list(self.supplied)}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> CalibrationItem:
        """What `to_dict` gave."""
        known = {one.name: document[one.name] for one in fields(cls)}
        received = known["received_at"]
        known["received_at"] = None if received is None else date.fromisoformat(received)
        return cls(**{**known, "supplied": tuple(known["supplied"])})


class Items(Part):
    """What was said of units as they came."""

    def item(self, unit: str, day: date | None = None) -> CalibrationItem | None:
        """What was said of a unit last; with a day, of those received by then. None where nobody did."""
        wanted = select(ItemTable).where(ItemTable.unit == unit).order_by(col(ItemTable.id).desc())
        with self._database.reading() as session:
            said = (CalibrationItem.from_dict(row.document) for row in session.exec(wanted))
            return next((one for one in said if not _came_after(one, day)), None)

    def say_item(self, unit: str, item: CalibrationItem, *, who: str | None) -> None:
        """Adds what somebody says of a unit, and puts it into the trail.

        Raises:
            NotFound: there is no such unit.
        """
        with self._database.writing() as session:
            if session.get(UnitTable, unit) is None:
                raise NotFound(f"there is no unit {unit!r}: a unit appears with its first run")
            session.add(ItemTable(unit=unit, document=item.to_dict(), at=datetime.now(UTC)))
            append(session, Act("item_changed", who=who, unit=unit, detail=item.to_dict()))


def _came_after(item: CalibrationItem, day: date | None) -> bool:
    return day is not None and item.received_at is not None and item.received_at > day
