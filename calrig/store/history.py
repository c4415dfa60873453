"""What is known about units over their runs: lists, comparison, the calibration in force."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sqlalchemy
from sqlmodel import Session, col, func, select

from calrig.store.convert import run_of
from calrig.store.records import ComparisonRow, Run, Unit
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
    CalibrationTable.bias_deg,
    CalibrationTable.bias_std_deg,
    CalibrationTable.scale,
    CalibrationTable.scale_std,
    CalibrationTable.rms_raw_deg,
    CalibrationTable.rms_calibrated_deg,
    CalibrationTable.rms_with_effects_deg,
    CalibrationTable.temperature_min_c,
    CalibrationTable.temperature_max_c,
)
"""In the order of `ComparisonRow`; columns, not objects of the tables: thousands come in milliseconds."""


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
    return [ComparisonRow._make(row) for row in session.connection().execute(wanted)]


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
