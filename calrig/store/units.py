"""Units over their runs: the list, the comparison, the calibration in force and the accepted effects."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import sqlalchemy
from sqlmodel import Session, col, func, or_, select

from calrig.store.checksums import check_numbers
from calrig.store.convert import FIGURES, result_part, run_of, run_row
from calrig.store.database import Part
from calrig.store.records import AcceptedEffect, ComparisonRow, Document, Run, Unit
from calrig.store.tables import AcceptedEffectTable, CalibrationTable, RunTable, UnitTable, UtcText

_COUNTS = (
    col(RunTable.status) == "completed",
    col(RunTable.kind) == "calibration",
    col(RunTable.voided_reason).is_(None),
)

_AT_ONCE = 500
"""Runs asked for by their ids in one question."""

_COMPARED: tuple[Any, ...] = (
    RunTable.unit,
    sqlalchemy.cast(RunTable.id, sqlalchemy.String),
    RunTable.rig,
    RunTable.finished_at,
    *(getattr(CalibrationTable, name) for name in FIGURES),
    CalibrationTable.crc32,
)
"""In the order of `ComparisonRow`; columns, not objects of the tables: thousands come in milliseconds."""


class Units(Part):
    """What is known about units over their runs."""

    def units(self) -> list[Unit]:
        """Every unit by serial number."""
        with self._database.reading() as session:
            return _units(session)

    def unit(self, serial: str) -> Unit | None:
        """The unit, or None."""
        with self._database.reading() as session:
            return next(iter(_units(session, serial)), None)

    def comparison(self, serials: Sequence[str] | None = None) -> list[ComparisonRow]:
        """The figures of every calibration that counts, by unit, the oldest of each first.

        That is: completed and not voided; no verification, static log or follow-up.

        Args:
            serials: the units to compare; None for all.
        """
        wanted = (
            sqlalchemy.select(*_COMPARED)
            .join(CalibrationTable, col(CalibrationTable.run_id) == RunTable.id)
            .where(*_COUNTS, col(RunTable.follows).is_(None))
            .order_by(col(RunTable.unit), col(RunTable.finished_at), col(RunTable.id))
        )
        if serials is not None:
            wanted = wanted.where(col(RunTable.unit).in_(serials))
        with self._database.reading() as session:
            return [_compared(row) for row in session.connection().execute(wanted)]

    def reference_figures(self, run_ids: Sequence[str]) -> dict[str, tuple[float, float | None]]:
        """What the stage is worth in the bias (deg) and scale of runs that know it: type B, by run."""
        found: dict[str, tuple[float, float | None]] = {}
        with self._database.reading() as session:
            for begin in range(0, len(run_ids), _AT_ONCE):
                ids = [int(one) for one in run_ids[begin : begin + _AT_ONCE]]
                wanted = select(RunTable.id, RunTable.result).where(col(RunTable.id).in_(ids))
                for run_id, result in session.exec(wanted):
                    reference = (result or {}).get("reference")
                    if reference is not None:
                        found[str(run_id)] = (reference["bias_std_deg"], reference["scale_std"])
        return found

    def latest_calibration_run(self, serial: str, *, follow_ups: bool = False) -> Run | None:
        """The latest completed, not voided `calibration` run (or import) whose scale is known, or None.

        `follow_ups` counts those as well, as stores did before there were revisions.
        """
        wanted = (
            select(RunTable)
            .join(CalibrationTable)
            .where(RunTable.unit == serial, *_COUNTS, col(CalibrationTable.scale).is_not(None))
            .order_by(col(RunTable.finished_at).desc(), col(RunTable.id).desc())
            .limit(1)
        )
        if not follow_ups:
            wanted = wanted.where(col(RunTable.follows).is_(None))
        with self._database.reading() as session:
            row = session.exec(wanted).first()
            return None if row is None else run_of(row)

    def accept_effects(self, run_id: str, accepted: Sequence[AcceptedEffect]) -> None:
        """Puts effects of a run's diagnosis in force from now on; the diagnosis says since when.

        Each for its unit or its rig, in place of an earlier one of that name.
        """
        now = datetime.now(UTC)
        with self._database.writing() as session:
            run = run_row(session, run_id)
            if run.diagnosis is not None:
                run.diagnosis = _marked(run.diagnosis, accepted, now)
            session.add_all(
                AcceptedEffectTable(
                    run_id=run.id,
                    unit=effect.unit,
                    rig=effect.rig,
                    name=effect.name,
                    origin=effect.origin,
                    parameters=effect.parameters,
                    accepted_at=now,
                )
                for effect in accepted
            )

    def effects_in_force(self, unit: str, rig: str | None) -> list[AcceptedEffect]:
        """The effects accepted for a unit and for a rig, the latest of each name."""
        wanted = (
            select(AcceptedEffectTable)
            .where(or_(AcceptedEffectTable.unit == unit, col(AcceptedEffectTable.rig) == (rig or "")))
            .where(col(AcceptedEffectTable.withdrawn_at).is_(None))
            .order_by(col(AcceptedEffectTable.id))
        )
        latest: dict[tuple[str | None, str], AcceptedEffect] = {}
        with self._database.reading() as session:
            for row in session.exec(wanted):
                latest[row.unit, row.name] = AcceptedEffect(
                    run_id=str(row.run_id),
                    unit=row.unit,
                    rig=row.rig,
                    name=row.name,
                    origin=row.origin,
                    parameters=row.parameters,
                    id=row.id,
                )
        return list(latest.values())

    def effect_names(self) -> dict[str, list[str]]:
        """Names of the effects accepted for each unit that has any."""
        wanted = (
            select(AcceptedEffectTable.unit, AcceptedEffectTable.name)
            .where(col(AcceptedEffectTable.unit).is_not(None))
            .distinct()
            .order_by(col(AcceptedEffectTable.unit), col(AcceptedEffectTable.name))
        )
        found: dict[str, list[str]] = {}
        with self._database.reading() as session:
            for unit, name in session.exec(wanted):
                found.setdefault(str(unit), []).append(name)
        return found


def _units(session: Session, serial: str | None = None) -> list[Unit]:
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


def _compared(row: Sequence[Any]) -> ComparisonRow:
    unit, run_id, rig, finished_at, *figures, crc32 = row
    check_numbers(crc32, figures, f"the figures of run {run_id}")
    return ComparisonRow(unit, run_id, rig, finished_at, result_part(figures))


def _marked(diagnosis: Document, accepted: Sequence[AcceptedEffect], now: datetime) -> Document:
    """The diagnosis, saying when effects of it were accepted: those of that name and with those values."""
    at = now.isoformat().replace("+00:00", "Z")
    marked = []
    for effect in diagnosis["effects"]:
        values = {name: given and given["value"] for name, given in effect["parameters"].items()}
        is_one = any((one.name, one.parameters) == (effect["name"], values) for one in accepted)
        marked.append({**effect, "accepted_at": at} if is_one else effect)
    return {**diagnosis, "effects": marked}
