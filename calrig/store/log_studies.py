"""What was found in logs that people brought, kept: the report and its pictures, not the log."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, cast

import sqlalchemy
from sqlmodel import col, select

from calrig.store.database import Part
from calrig.store.finding_tables import LogStudyTable
from calrig.store.records import Document

StudyKind = Literal["noise", "filters"]
MOST_LISTED = 200
_STUDY = sqlalchemy.inspect(LogStudyTable).local_table.c


@dataclass(frozen=True, slots=True)
class LogStudy:
    """A study that was made: of which file, when, and by whom where that is known by name."""

    id: str
    created_at: datetime
    studied_by: str | None
    kind: StudyKind
    file_name: str


class LogStudies(Part):
    """The studies there are."""

    def keep_study(
        self, kind: StudyKind, file_name: str, document: Document, *, who: str | None = None
    ) -> LogStudy:
        """Keeps what was found in a log."""
        with self._database.writing() as session:
            row = LogStudyTable(
                id=str(uuid.uuid4()),
                created_at=datetime.now(UTC),
                studied_by=who,
                kind=kind,
                file_name=file_name,
                document=document,
            )
            session.add(row)
            return _of(row)

    def studies(self) -> list[LogStudy]:
        """The latest of them, the newest first, without what they found."""
        wanted = sqlalchemy.select(
            _STUDY.id, _STUDY.created_at, _STUDY.studied_by, _STUDY.kind, _STUDY.file_name
        ).order_by(_STUDY.created_at.desc(), _STUDY.id.desc())
        with self._database.reading() as session:
            return [LogStudy(*row) for row in session.connection().execute(wanted.limit(MOST_LISTED))]

    def study(self, study_id: str) -> tuple[LogStudy, Document] | None:
        """One with what it found; None where there is none of that id."""
        with self._database.reading() as session:
            row = session.exec(select(LogStudyTable).where(col(LogStudyTable.id) == study_id)).first()
            return None if row is None else (_of(row), row.document)

    def remove_study(self, study_id: str) -> bool:
        """Whether there was one."""
        with self._database.writing() as session:
            row = session.get(LogStudyTable, study_id)
            if row is not None:
                session.delete(row)
            return row is not None


def _of(row: LogStudyTable) -> LogStudy:
    return LogStudy(row.id, row.created_at, row.studied_by, cast(StudyKind, row.kind), row.file_name)
