"""The stage's map that a rig's elevations rest on: put in force, followed by another one, withdrawn."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from sqlmodel import Session, col, select

from calrig.store.database import Part
from calrig.store.errors import NotFound
from calrig.store.finding_tables import StageMapTable
from calrig.store.records import Document
from calrig.store.trail import Act, append


@dataclass(frozen=True, slots=True)
class MapInForce:
    """A rig's map: the `stage-map.json` of a stored solution, since when, and by whom."""

    rig: str
    solution_id: str
    document: Document
    sha256: str
    put_at: datetime
    put_by: str | None


class StageMaps(Part):
    """At most one map is in force for a rig."""

    def stage_map(self, rig: str) -> MapInForce | None:
        """The one in force, or None."""
        with self._database.reading() as session:
            row = _in_force(session, rig)
            return None if row is None else _of(row)

    def stage_maps(self) -> list[MapInForce]:
        """Every rig's that has one, by name of the rig."""
        wanted = (
            select(StageMapTable)
            .where(col(StageMapTable.withdrawn_at).is_(None))
            .order_by(col(StageMapTable.rig))
        )
        with self._database.reading() as session:
            return [_of(row) for row in session.exec(wanted)]

    def put_stage_map(
        self, rig: str, solution_id: str, document: Document, *, who: str | None = None
    ) -> MapInForce:
        """Puts the map of a stored solution in force, in the place of the one before.

        Args:
            rig: whose stage it is of.
            solution_id: of the solution.
            document: its map, which has been looked at.
            who: did it.
        """
        with self._database.writing() as session:
            now = datetime.now(UTC)
            before = _in_force(session, rig)
            if before is not None:
                before.withdrawn_at = now
                session.add(before)
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
            return _of(row)

    def withdraw_stage_map(self, rig: str, reason: str, *, who: str | None = None) -> None:
        """Has a rig go without one.

        Raises:
            NotFound: it has none.
        """
        with self._database.writing() as session:
            row = _in_force(session, rig)
            if row is None:
                raise NotFound(f"rig {rig!r} has no stage's map in force")
            row.withdrawn_at = datetime.now(UTC)
            session.add(row)
            detail = {"solve": row.solution_id, "sha256": row.sha256}
            append(session, Act("map_withdrawn", who=who, rig=rig, reason=reason, detail=detail))


def _in_force(session: Session, rig: str) -> StageMapTable | None:
    wanted = select(StageMapTable).where(StageMapTable.rig == rig, col(StageMapTable.withdrawn_at).is_(None))
    return session.exec(wanted).first()


def _of(row: StageMapTable) -> MapInForce:
    return MapInForce(row.rig, row.solution_id, row.document, row.sha256, row.put_at, row.put_by)
