"""What is known about units over their runs: lists, comparison, the calibration in force."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import sqlalchemy
from sqlmodel import Session, col, func, select

from calrig.store.checksums import check_numbers
from calrig.store.convert import FIGURES, run_of
from calrig.store.records import ComparisonRow, Run, Status, Unit
from calrig.store.tables import CalibrationTable, RunTable, UnitTable, UtcText

_IN_FORCE = (
    col(RunTable.status) == "completed",
    col(RunTable.kind) == "calibration",
    col(RunTable.voided_reason).is_(None),
)

_COMPARED: tuple[Any, ...] = (
    RunTable.unit,
    sqlalchemy.cast(RunTable.id, sqlalchemy.String),
    RunTable.rig,
    RunTable.finished_at,
    *(getattr(CalibrationTable, name) for name in FIGURES),
    CalibrationTable.crc32,
)
"""In the order of `ComparisonRow`; columns, not objects of the tables: thousands come in milliseconds."""
_NOT_FIGURES = len(_COMPARED) - len(FIGURES) - 1


def count_runs(session: Session) -> dict[str, int]:
    """How many runs there are of each status, those without any as well."""
    counted = session.exec(select(RunTable.status, func.count()).group_by(col(RunTable.status)))
    return {**dict.fromkeys(get_args(Status), 0), **dict(counted.all())}


def units(session: Session, serial: str | None = None) -> list[Unit]:
    """All units by serial, or the one."""
    wanted = (
        select(UnitTable, func.count(col(RunTable.id)), func.max(RunTable.created_at, type_=UtcText()))
        .join(RunTable, isouter=True)
        .group_by(col(UnitTable.serial))
        .order_by(col(UnitTable.serial))
    )
    if serial is not None:
        wanted = wanted.where(UnitTable.serial == serial)
    return [
        Unit(serial=unit.serial, created_at=unit.created_at, n_runs=n_runs, last_run_at=last)
        for unit, n_runs, last in session.exec(wanted)
    ]


def comparison(session: Session, serials: Sequence[str] | None) -> list[ComparisonRow]:
    """The figures of every completed, not voided calibration, by unit, the oldest of each first."""
    wanted = (
        sqlalchemy.select(*_COMPARED)
        .join(CalibrationTable, col(CalibrationTable.run_id) == RunTable.id)
        .where(*_IN_FORCE)
        .order_by(col(RunTable.unit), col(RunTable.finished_at), col(RunTable.id))
    )
    if serials is not None:
        wanted = wanted.where(col(RunTable.unit).in_(serials))
    return [_compared(row) for row in session.connection().execute(wanted)]


def _compared(row: Sequence[Any]) -> ComparisonRow:
    *shown, crc32 = row
    check_numbers(crc32, shown[_NOT_FIGURES:], f"the figures of run {shown[1]}")
    return ComparisonRow._make(shown)


def latest_calibration(session: Session, serial: str) -> Run | None:
    """The run whose calibration is in force for a unit: the latest whose scale is known."""
    wanted = (
        select(RunTable)
        .join(CalibrationTable)
        .where(RunTable.unit == serial, *_IN_FORCE, col(CalibrationTable.scale).is_not(None))
        .order_by(col(RunTable.finished_at).desc(), col(RunTable.id).desc())
        .limit(1)
    )
    row = session.exec(wanted).first()
    return None if row is None else run_of(row)
