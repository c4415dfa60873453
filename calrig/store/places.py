"""Where stages that cannot look for a reference were left, by rig: nothing else remembers it."""

from __future__ import annotations

from datetime import UTC, datetime

from calrig.store.database import Part
from calrig.store.records import LeftAt
from calrig.store.tables import StagePlaceTable


class Places(Part):
    """One place a rig."""

    def left_at(self, rig: str) -> LeftAt | None:
        """Where a rig's stage was left; None where nobody has ever said."""
        with self._database.reading() as session:
            row = session.get(StagePlaceTable, rig)
            return None if row is None else LeftAt(row.stage_deg, row.at)

    def leave_at(self, rig: str, stage_deg: float | None) -> None:
        """Keeps where a rig's stage stands, in the stage's own degrees; None while nobody knows."""
        with self._database.writing() as session:
            session.merge(StagePlaceTable(rig=rig, stage_deg=stage_deg, at=datetime.now(UTC)))
