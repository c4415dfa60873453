"""Issued revisions of calibrations: their bytes never change; status, author and reason are stored beside."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import cast, get_args

import sqlalchemy
from sqlmodel import Session, and_, col, func, select

from calrig.canonical_json import canonical, sha256_of
from calrig.model.calibration import RevisionStatus
from calrig.store import trail
from calrig.store.convert import iso_utc, run_row
from calrig.store.database import Repository, row_of
from calrig.store.errors import Refused, Unreadable
from calrig.store.records import Document
from calrig.store.tables import IssuedCalibrationTable, RunTable, TrailTable, UtcText


@dataclass(frozen=True, slots=True)
class Draft:
    """What a revision is made of before it is numbered.

    Attributes:
        content: CONTRACT section 6 less what the store knows: run, revision, times, hash, and the run's
            provenance, beside which its own stands.
        basis: what it rests on, to be held against the same later (`calrig.analysis.revisions`).
        verdict: CONTRACT section 2's, as it was when it was made.
        releases: whether it is put in force as it is made.
        by: who made it; None where nobody is known by name.
        doubts: why it is not released by itself (`calibration.uncertainty.doubts`), kept with the result as
            well; None where they are not about the run's own result.
    """

    content: Document
    basis: Document
    verdict: Document
    releases: bool
    by: str | None = None
    reason: str | None = None
    doubts: list[Document] | None = None


@dataclass(frozen=True, slots=True)
class Revision:
    """A revision of a unit's calibration; `text` are the bytes as issued, in UTF-8 once encoded."""

    unit: str
    revision: int
    status: RevisionStatus
    run_id: str
    text: str
    sha256: str
    basis: Document
    verdict: Document
    issued_at: datetime
    issued_by: str | None
    reason: str | None

    @property
    def document(self) -> Document:
        """CONTRACT section 6."""
        return cast(Document, json.loads(self.text))

    @property
    def warnings(self) -> list[str]:
        """Why it was not released by itself; documents of before say nothing of it."""
        return list(self.document.get("warnings") or ())


@dataclass(frozen=True, slots=True)
class InForce:
    """What a list of units shows of the revision in force: no document is read for it.

    Attributes:
        since: time of its last release; of stores without a trail, when it was issued.
    """

    revision: int
    since: datetime
    verdict: Document


def issue(session: Session, run: RunTable, draft: Draft) -> IssuedCalibrationTable:
    """Numbers and freezes a draft of a finished run, in a transaction that somebody else has begun."""
    now = datetime.now(UTC)
    newest = select(func.max(IssuedCalibrationTable.revision)).where(IssuedCalibrationTable.unit == run.unit)
    revision = (session.exec(newest).one() or 0) + 1
    document = {
        **draft.content,
        "revision": revision,
        "run_id": run.uid,
        "calibrated_at": None if run.finished_at is None else iso_utc(run.finished_at),
        "issued_at": iso_utc(now),
        "provenance": {**run.provenance, **draft.content.get("provenance", {})},
    }
    sha256 = sha256_of(document)
    row = IssuedCalibrationTable(
        unit=run.unit,
        revision=revision,
        run_id=run.id,
        document=canonical({**document, "sha256": sha256}),
        sha256=sha256,
        status="draft",
        basis=draft.basis,
        verdict=draft.verdict,
        issued_at=now,
        issued_by=draft.by,
        reason=draft.reason,
    )
    session.add(row)
    if draft.doubts is not None and run.result is not None:
        run.result = {**run.result, "doubts": draft.doubts}
    session.flush()
    _note(session, "drafted", row, draft.by, draft.reason, now)
    if draft.releases:
        _release(session, row, draft.by, draft.reason, now)
    return row


class Revisions(Repository):
    """The revisions of units' calibrations. At most one of a unit is in force."""

    def issue(self, run_id: str, draft: Draft) -> Revision:
        """Makes the next revision of a run's unit."""
        with self._database.writing() as session:
            return _revision(issue(session, run_row(session, run_id), draft))

    def of(self, unit: str) -> list[Revision]:
        """All of a unit's, newest first."""
        wanted = (
            select(IssuedCalibrationTable)
            .where(IssuedCalibrationTable.unit == unit)
            .order_by(col(IssuedCalibrationTable.revision).desc())
        )
        with self._database.reading() as session:
            return [_revision(row) for row in session.exec(wanted)]

    def get(self, unit: str, number: int) -> Revision | None:
        """One of a unit's, or None."""
        with self._database.reading() as session:
            row = session.get(IssuedCalibrationTable, (unit, number))
            return None if row is None else _revision(row)

    def in_force(self, unit: str) -> Revision | None:
        """The one in force, or None."""
        return next(iter(self.all_in_force([unit])), None)

    def all_in_force(self, units: Sequence[str] | None = None) -> list[Revision]:
        """The ones in force, by unit; of all units where none are named."""
        wanted = select(IssuedCalibrationTable).where(IssuedCalibrationTable.status == "in_force")
        if units is not None:
            wanted = wanted.where(col(IssuedCalibrationTable.unit).in_(units))
        with self._database.reading() as session:
            rows = session.exec(wanted.order_by(col(IssuedCalibrationTable.unit))).all()
            return [_revision(row) for row in rows]

    def summaries_in_force(self, units: Sequence[str] | None = None) -> dict[str, InForce]:
        """Return number, release and verdict of the ones in force, by unit; of all units for None."""
        table, of = IssuedCalibrationTable, (col(TrailTable.unit), col(TrailTable.revision))
        last = func.max(TrailTable.at, type_=UtcText()).label("at")
        released = select(*of, last).where(TrailTable.what == "released").group_by(*of).subquery()
        here = and_(released.c.unit == table.unit, released.c.revision == table.revision)
        columns = table.unit, table.revision, table.issued_at, table.verdict, released.c.at
        wanted = sqlalchemy.select(*columns).join(released, here, isouter=True)  # type: ignore[call-overload]
        wanted = wanted.where(col(table.status) == "in_force")
        if units is not None:
            wanted = wanted.where(col(table.unit).in_(units))
        with self._database.reading() as session:
            rows = session.connection().execute(wanted)
            return {unit: InForce(number, at or issued, said) for unit, number, issued, said, at in rows}

    def release(self, unit: str, number: int, by: str | None, reason: str | None) -> Revision:
        """Puts a draft, or a superseded revision once more, in force in place of the one that was.

        Raises:
            NotFound: there is no such revision.
            Refused: it is in force already, or was withdrawn.
        """
        with self._database.writing() as session:
            row = _row(session, unit, number)
            if row.status not in ("draft", "superseded"):
                other = ": make a new draft instead" if row.status == "withdrawn" else ""
                is_so = "in force already" if row.status == "in_force" else row.status
                raise Refused(f"revision {number} of unit {unit!r} is {is_so}{other}")
            _release(session, row, by, reason, datetime.now(UTC))
            return _revision(row)

    def withdraw(self, unit: str, number: int, by: str | None, reason: str) -> Revision:
        """Takes a revision back for good; where it was in force, none is afterwards.

        Raises:
            NotFound: there is no such revision.
            Refused: it has been withdrawn.
        """
        with self._database.writing() as session:
            row = _row(session, unit, number)
            if row.status == "withdrawn":
                raise Refused(f"revision {number} of unit {unit!r} has been withdrawn already")
            row.status = "withdrawn"
            _note(session, "withdrawn", row, by, reason, datetime.now(UTC))
            session.flush()
            return _revision(row)

    def withdrawn_runs(self) -> set[str]:
        """Ids of the runs whose revisions are all withdrawn."""
        is_valid = col(IssuedCalibrationTable.status) != "withdrawn"
        valid = select(IssuedCalibrationTable.run_id).where(is_valid)
        wanted = select(RunTable.uid).join(IssuedCalibrationTable)
        wanted = wanted.where(~is_valid, col(RunTable.id).not_in(valid))
        with self._database.reading() as session:
            return set(session.exec(wanted))

    def units_without(self) -> list[str]:
        """Units that runs are of and no revision is."""
        issued = select(IssuedCalibrationTable.unit)
        wanted = select(RunTable.unit).where(col(RunTable.unit).not_in(issued)).distinct()
        with self._database.reading() as session:
            return sorted(session.exec(wanted))


def _release(
    session: Session, row: IssuedCalibrationTable, by: str | None, reason: str | None, now: datetime
) -> None:
    wanted = select(IssuedCalibrationTable).where(
        IssuedCalibrationTable.unit == row.unit, IssuedCalibrationTable.status == "in_force"
    )
    before = session.exec(wanted).first()
    if before is not None:
        before.status = "superseded"
        session.flush()  # the database refuses two in force
    row.status = "in_force"
    session.flush()
    detail = {} if before is None else {"supersedes": before.revision}
    _note(session, "released", row, by, reason, now, detail)


def _note(
    session: Session,
    what: trail.What,
    row: IssuedCalibrationTable,
    by: str | None,
    reason: str | None,
    now: datetime,
    detail: Document | None = None,
) -> None:
    revision = _revision(row)
    warnings = {"warnings": revision.warnings} if revision.warnings else {}
    said = {"sha256": row.sha256, **warnings, **(detail or {})}
    act = trail.Act(what, by, row.unit, None, revision.run_id, row.revision, reason, said)
    trail.append(session, act, now)


def _row(session: Session, unit: str, number: int) -> IssuedCalibrationTable:
    missing = f"unit {unit!r} has no revision {number}"
    return row_of(session, IssuedCalibrationTable, (unit, number), missing)


def _revision(row: IssuedCalibrationTable) -> Revision:
    what = f"revision {row.revision} of unit {row.unit!r}"
    try:
        document = json.loads(row.document)
        sha256 = sha256_of(document)
    except (TypeError, ValueError, AttributeError) as error:
        raise Unreadable(f"{what} is no document any more: {error}") from error
    if sha256 != row.sha256 or row.status not in get_args(RevisionStatus):
        raise Unreadable(f"{what} is not what was issued")
    return Revision(
        unit=row.unit,
        revision=row.revision,
        status=cast(RevisionStatus, row.status),
        run_id=document["run_id"],
        text=row.document,
        sha256=row.sha256,
        basis=row.basis,
        verdict=row.verdict,
        issued_at=row.issued_at,
        issued_by=row.issued_by,
        reason=row.reason,
    )
