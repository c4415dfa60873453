"""State of rigs that outlives a process: check standards, stage positions, stage maps; summaries of rigs."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import sqlalchemy
from sqlalchemy import ColumnElement
from sqlmodel import Session, and_, col, func, or_, select

from calrig.model.base import Model
from calrig.model.run import UNFINISHED
from calrig.store.database import Repository, row_of
from calrig.store.errors import NotFound
from calrig.store.records import Document, StoredStagePosition
from calrig.store.runs import VALID_CALIBRATION
from calrig.store.tables import (
    CalibrationTable,
    CheckUnitTable,
    RunTable,
    StageMapTable,
    StagePlaceTable,
    UnitTable,
)
from calrig.store.trail import Act, append


class CheckUnit(Model):
    """A rig's check unit: runs of it on the rig from `named_at` on are checks, those before its history."""

    rig: str
    unit: str
    interval_days: float
    named_at: datetime


class CheckStandards(Repository):
    """One check unit a rig."""

    def all(self) -> list[CheckUnit]:
        """Every rig's that has one, by name of the rig."""
        with self._database.reading() as session:
            rows = session.exec(select(CheckUnitTable).order_by(col(CheckUnitTable.rig)))
            return [CheckUnit.model_validate(row) for row in rows]

    def of(self, rig: str) -> CheckUnit | None:
        """A rig's, or None."""
        with self._database.reading() as session:
            row = session.get(CheckUnitTable, rig)
            return None if row is None else CheckUnit.model_validate(row)

    def name(self, rig: str, unit: str, interval_days: float, *, who: str | None = None) -> CheckUnit:
        """Names a rig's check unit, or gives it another interval; another unit begins anew.

        Raises:
            NotFound: there is no such unit.
        """
        with self._database.writing() as session:
            row_of(session, UnitTable, unit, f"there is no unit {unit!r}: a unit appears with its first run")
            row = session.get(CheckUnitTable, rig)
            if row is None or row.unit != unit:
                named = CheckUnit(rig=rig, unit=unit, interval_days=interval_days, named_at=datetime.now(UTC))
                row = session.merge(CheckUnitTable(**named.model_dump()))
            row.interval_days = interval_days
            _tell(session, rig, unit, who, {"unit": unit, "interval_days": interval_days})
            return CheckUnit.model_validate(row)

    def remove(self, rig: str, *, who: str | None = None) -> None:
        """Has a rig go without one.

        Raises:
            NotFound: it has none.
        """
        with self._database.writing() as session:
            row = row_of(session, CheckUnitTable, rig, f"rig {rig!r} has no check unit")
            session.delete(row)
            _tell(session, rig, row.unit, who, {"unit": None, "interval_days": None})


def _tell(session: Session, rig: str, unit: str, who: str | None, detail: dict[str, object]) -> None:
    append(session, Act("check_unit_changed", who=who, rig=rig, unit=unit, detail=detail))


class StagePositions(Repository):
    """One place a rig."""

    def of(self, rig: str) -> StoredStagePosition | None:
        """Where a rig's stage was left; None where nobody has ever said."""
        with self._database.reading() as session:
            row = session.get(StagePlaceTable, rig)
            return None if row is None else StoredStagePosition(row.stage_deg, row.at)

    def save(self, rig: str, stage_deg: float | None) -> None:
        """Keeps where a rig's stage stands, in the stage's own degrees; None while nobody knows."""
        with self._database.writing() as session:
            session.merge(StagePlaceTable(rig=rig, stage_deg=stage_deg, at=datetime.now(UTC)))


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
    col(RunTable.voided_reason).is_not(None),
)
"""Of a `BriefRun`, behind its rig; no objects of the tables, whose plans and provenance nobody reads here."""


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


class RigSummaries(Repository):
    """Of many rigs at once."""

    def summaries(self, rigs: Sequence[str]) -> dict[str, Standing]:
        """By name of the rig, in one state of the store."""
        found = {name: Standing() for name in rigs}
        if not found:
            return found
        with self._database.reading() as session:
            for row in session.connection().execute(_unfinished(rigs)):
                found[row.rig].unfinished.append(BriefRun(*row[1:]))
            for row in session.connection().execute(_last(rigs)):
                found[row.rig].last = BriefRun(*row[1:])
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
        .where(*VALID_CALIBRATION, col(RunTable.follows).is_(None))
        .scalar_subquery()
    )
    wanted = select(CheckUnitTable, last_at).where(col(CheckUnitTable.rig).in_(rigs))
    return [(CheckUnit.model_validate(row), at) for row, at in session.exec(wanted)]


class MapInForce(Model):
    """A rig's map: the `stage-map.json` of a stored solution, since when, and by whom."""

    rig: str
    solution_id: str
    document: Document
    sha256: str
    put_at: datetime
    put_by: str | None


class StageMaps(Repository):
    """At most one map is in force for a rig."""

    def of(self, rig: str) -> MapInForce | None:
        """The one in force, or None."""
        with self._database.reading() as session:
            row = _in_force(session, rig)
            return None if row is None else MapInForce.model_validate(row)

    def all(self) -> list[MapInForce]:
        """Every rig's that has one, by name of the rig."""
        wanted = (
            select(StageMapTable)
            .where(col(StageMapTable.withdrawn_at).is_(None))
            .order_by(col(StageMapTable.rig))
        )
        with self._database.reading() as session:
            return [MapInForce.model_validate(row) for row in session.exec(wanted)]

    def put_in_force(
        self, rig: str, solution_id: str, document: Document, *, who: str | None = None
    ) -> MapInForce:
        """Puts the map of a stored solution in force, in the place of the one before.

        `document` is its map, which has been looked at.
        """
        with self._database.writing() as session:
            now = datetime.now(UTC)
            before = _in_force(session, rig)
            if before is not None:
                before.withdrawn_at = now
                session.flush()
            row = StageMapTable(
                rig=rig,
                solution_id=solution_id,
                document=document,
                sha256=document["sha256"],
                put_at=now,
                put_by=who,
            )
            session.add(row)
            session.flush()
            detail = {"solve": solution_id, "sha256": row.sha256, "before": before and before.sha256}
            append(session, Act("map_put_in_force", who=who, rig=rig, detail=detail), now)
            return MapInForce.model_validate(row)

    def withdraw(self, rig: str, reason: str, *, who: str | None = None) -> None:
        """Has a rig go without one.

        Raises:
            NotFound: it has none.
        """
        with self._database.writing() as session:
            row = _in_force(session, rig)
            if row is None:
                raise NotFound(f"rig {rig!r} has no stage's map in force")
            row.withdrawn_at = datetime.now(UTC)
            detail = {"solve": row.solution_id, "sha256": row.sha256}
            append(session, Act("map_withdrawn", who=who, rig=rig, reason=reason, detail=detail))


def _in_force(session: Session, rig: str) -> StageMapTable | None:
    wanted = select(StageMapTable).where(StageMapTable.rig == rig, col(StageMapTable.withdrawn_at).is_(None))
    return session.exec(wanted).first()
