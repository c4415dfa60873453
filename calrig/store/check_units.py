"""The unit that a rig is checked by, and how often."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from sqlmodel import Session, col, select

from calrig.store.database import Part
from calrig.store.errors import NotFound
from calrig.store.tables import CheckUnitTable, UnitTable
from calrig.store.trail import Act, append


@dataclass(frozen=True, slots=True)
class CheckUnit:
    """A rig's check unit: runs of it on the rig from `named_at` on are checks, those before its history."""

    rig: str
    unit: str
    interval_days: float
    named_at: datetime


class CheckUnits(Part):
    """One check unit a rig."""

    def check_units(self) -> list[CheckUnit]:
        """Every rig's that has one, by name of the rig."""
        with self._database.reading() as session:
            return [
                _of(row) for row in session.exec(select(CheckUnitTable).order_by(col(CheckUnitTable.rig)))
            ]

    def check_unit(self, rig: str) -> CheckUnit | None:
        """A rig's, or None."""
        with self._database.reading() as session:
            row = session.get(CheckUnitTable, rig)
            return None if row is None else _of(row)

    def name_check_unit(
        self, rig: str, unit: str, interval_days: float, *, who: str | None = None
    ) -> CheckUnit:
        """Names a rig's check unit, or gives it another interval; another unit begins anew.

        Raises:
            NotFound: there is no such unit.
        """
        with self._database.writing() as session:
            if session.get(UnitTable, unit) is None:
                raise NotFound(f"there is no unit {unit!r}: a unit appears with its first run")
            row = session.get(CheckUnitTable, rig)
            if row is None or row.unit != unit:
                row = session.merge(
                    CheckUnitTable(
                        rig=rig, unit=unit, interval_days=interval_days, named_at=datetime.now(UTC)
                    )
                )
            row.interval_days = interval_days
            session.add(row)
            _tell(session, rig, unit, who, {"unit": unit, "interval_days": interval_days})
            return _of(row)

    def remove_check_unit(self, rig: str, *, who: str | None = None) -> None:
        """Has a rig go without one.

        Raises:
            NotFound: it has none.
        """
        with self._database.writing() as session:
            row = session.get(CheckUnitTable, rig)
            if row is None:
                raise NotFound(f"rig {rig!r} has no check unit")
            session.delete(row)
            _tell(session, rig, row.unit, who, {"unit": None, "interval_days": None})


def _tell(session: Session, rig: str, unit: str, who: str | None, detail: dict[str, object]) -> None:
    append(session, Act("check_unit_changed", who=who, rig=rig, unit=unit, detail=detail))


def _of(row: CheckUnitTable) -> CheckUnit:
    return CheckUnit(row.rig, row.unit, row.interval_days, row.named_at)
