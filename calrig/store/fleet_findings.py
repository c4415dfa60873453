"""What the re-analysis of a fleet found in runs, kept so that it is found once."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy

from calrig.store.database import Part
from calrig.store.finding_tables import FleetFindingTable
from calrig.store.records import Document

_FINDING = sqlalchemy.inspect(FleetFindingTable).local_table.c
_LISTED = (
    _FINDING.run_uid,
    _FINDING.poses_sha256,
    _FINDING.catalogue,
    _FINDING.diagnosis["verdict"].as_string(),
)


@dataclass(frozen=True, slots=True)
class Finding:
    """The verdict on some poses of a run by some catalogue; None where they cannot be diagnosed."""

    poses_sha256: str
    catalogue: str
    verdict: str | None


class FleetFindings(Part):
    """One finding a run, the last one."""

    def findings(self) -> dict[str, Finding]:
        """All of them, by the run's id."""
        with self._database.reading() as session:
            rows = session.connection().execute(sqlalchemy.select(*_LISTED))
            return {run_id: Finding(*row) for run_id, *row in rows}

    def finding_document(self, run_id: str) -> Document | None:
        """The whole diagnosis; None where there is none."""
        with self._database.reading() as session:
            row = session.get(FleetFindingTable, run_id)
            return None if row is None else row.diagnosis

    def keep_finding(
        self,
        run_id: str,
        poses_sha256: str,
        catalogue: str,
        diagnosis: Document | None,
        error: str | None = None,
    ) -> None:
        """Keeps what was found in the place of what was kept before.

        Args:
            run_id: of this store or of another one.
            poses_sha256: of the poses that it was found in.
            catalogue: version of that which found it.
            diagnosis: CONTRACT section 5; None where the poses cannot be diagnosed.
            error: then the reason.
        """
        row = FleetFindingTable(
            run_uid=run_id,
            poses_sha256=poses_sha256,
            catalogue=catalogue,
            diagnosis=diagnosis,
            error=error,
            at=datetime.now(UTC),
        )
        with self._database.writing() as session:
            session.merge(row)
