"""How each rig stands, for a page that shows many at once: a few narrow questions to the store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

import sqlalchemy
from sqlalchemy import ColumnElement, Row
from sqlmodel import Session, and_, col, func, or_, select

from calrig.store.check_units import CheckUnit
from calrig.store.database import Part
from calrig.store.records import UNFINISHED, Document
from calrig.store.tables import CalibrationTable, CheckUnitTable, RunTable
from calrig.store.units import COUNTS

_BRIEF: tuple[Any, ...] = (
    RunTable.rig,
    RunTable.uid,
    RunTable.unit,
    RunTable.kind,
    RunTable.status,
    RunTable.progress,
    RunTable.created_at,
    RunTable.finished_at,
    RunTable.error,
    RunTable.voided_reason,
)
"""Columns, not objects of the tables, whose plans and provenance nobody reads here."""


@dataclass(frozen=True, slots=True)
class BriefRun:
    """A run as a list of rigs shows it."""

    id: str
    unit: str
    kind: str
    status: str
    progress: Document
    created_at: datetime
    finished_at: datetime | None
    error: str | None
    is_voided: bool


@dataclass(frozen=True, slots=True)
class NextCheck:
    """When a rig's check unit is to be put on it again."""

    unit: str
    due_at: datetime


@dataclass(slots=True)
class Standing:
    """What the store knows of a rig.

    Attributes:
        unfinished: the run that goes on first, then those that wait, the oldest first.
        last: the run made last of those that have begun; None where none has.
        check: None where the rig has no check unit.
    """

    unfinished: list[BriefRun] = field(default_factory=list)
    last: BriefRun | None = None
    check: NextCheck | None = None


class RigStandings(Part):
    """Of many rigs at once."""

    def standings(self, rigs: Sequence[str]) -> dict[str, Standing]:
        """By name of the rig, in one state of the store."""
        found = {name: Standing() for name in rigs}
        if not found:
            return found
        with self._database.reading() as session:
            for row in session.connection().execute(_unfinished(rigs)):
                found[row.rig].unfinished.append(_brief(row))
            for row in session.connection().execute(_last(rigs)):
                found[row.rig].last = _brief(row)
            for check, last_at in _checks(session, rigs):
                since = last_at or check.named_at
                due_at = since + timedelta(days=check.interval_days)
                found[check.rig].check = NextCheck(check.unit, due_at)
        return found


def _unfinished(rigs: Sequence[str]) -> sqlalchemy.Select[Any]:
    return (
        sqlalchemy.select(*_BRIEF)
        .where(col(RunTable.status).in_(UNFINISHED), col(RunTable.rig).in_(rigs))
        .order_by(col(RunTable.status) == "queued", col(RunTable.created_at), col(RunTable.id))
    )


def _last(rigs: Sequence[str]) -> sqlalchemy.Select[Any]:
    """One look into the index for each rig: over all runs at once it would read every one of them."""
    newest = col(RunTable.created_at).desc(), col(RunTable.id).desc()
    has_begun = or_(col(RunTable.status) != "queued", col(RunTable.started_at).is_not(None))
    ids: list[ColumnElement[int]] = [
        select(RunTable.id)
        .where(RunTable.rig == name, has_begun)
        .order_by(*newest)
        .limit(1)
        .scalar_subquery()
        for name in rigs
    ]
    return sqlalchemy.select(*_BRIEF).where(col(RunTable.id).in_(ids))


def _checks(session: Session, rigs: Sequence[str]) -> list[tuple[CheckUnit, datetime | None]]:
    """The check units, and when each was last calibrated on its rig."""
    last_at = (
        select(func.max(RunTable.finished_at))
        .join(CalibrationTable, and_(col(CalibrationTable.run_id) == RunTable.id))
        .where(RunTable.unit == CheckUnitTable.unit, RunTable.rig == CheckUnitTable.rig)
        .where(*COUNTS, col(RunTable.follows).is_(None))
        .scalar_subquery()
    )
    wanted = select(CheckUnitTable, last_at).where(col(CheckUnitTable.rig).in_(rigs))
    return [
        (CheckUnit(row.rig, row.unit, row.interval_days, row.named_at), at)
        for row, at in session.exec(wanted)
    ]


def _brief(row: Row[Any]) -> BriefRun:
    return BriefRun(
        id=row.uid,
        unit=row.unit,
        kind=row.kind,
        status=row.status,
        progress=row.progress,
        created_at=row.created_at,
        finished_at=row.finished_at,
        error=row.error,
        is_voided=row.voided_reason is not None,
    )
