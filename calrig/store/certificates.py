"""Certificates as they were issued: number, bytes, hashes, who, when and on what settings."""

import hashlib
from datetime import datetime
from typing import Literal

from pydantic import Field
from sqlalchemy import ColumnElement
from sqlalchemy.orm import defer
from sqlmodel import Session, col, select

from calrig.laboratory import LaboratorySettings
from calrig.model.base import Model
from calrig.model.calibration import RevisionStatus
from calrig.store.database import Repository, row_of
from calrig.store.errors import NotFound, Refused, Unreadable
from calrig.store.records import Document
from calrig.store.tables import CertificateTable, IssuedCalibrationTable
from calrig.store.trail import Act, append

Form = Literal["pdf", "dcc"]
STATED = (*LaboratorySettings().as_stated(), "country")
"""Of the settings, what the trail keeps; paths of files and keys are no part of it."""


class IssuedCertificate(Model):
    """A certificate without its bytes; `reason` is why it replaces another one."""

    number: str
    unit: str
    revision: int
    issued_at: datetime = Field(description="Of the certificate; the document keeps its own.")
    issued_by: str | None
    replaces: str | None = Field(description="The certificate that this one corrects.")
    replaced_by: str | None = Field(default=None, description="The certificate that corrects this one.")
    reason: str | None
    sha256: dict[Literal["pdf", "dcc", "json"], str | None] = Field(
        description="Of the bytes served; `pdf` null where none could be made."
    )
    settings: Document = Field(description="Of the laboratory, when it was issued.")
    trail_seq: int = Field(description="Number of the newest entry of the trail when it was issued.")
    trail_sha256: str


class Certificates(Repository):
    """Every certificate that was issued; none ever changes."""

    def add(
        self, issued: IssuedCertificate, pdf: bytes | None, dcc: bytes, status: RevisionStatus
    ) -> IssuedCertificate:
        """Store a certificate and its entry in the trail; `status` is that of its revision in the bytes.

        Raises:
            NotFound: there is no certificate of the number that it replaces.
            Refused: that one is of another unit, or was replaced already; or the revision has another status
                since the bytes were made.
        """
        said = issued.model_dump(exclude={"replaced_by"})
        with self._database.writing() as session:
            revision = session.get(IssuedCalibrationTable, (issued.unit, issued.revision))
            now = None if revision is None else revision.status
            if now != status:
                raise Refused(
                    f"revision {issued.revision} of unit {issued.unit!r} was {status.replace('_', ' ')} when "
                    f"its certificate was made and is {(now or 'gone').replace('_', ' ')} now: nothing was "
                    "issued; look at the revision and issue its certificate again"
                )
            if issued.replaces is not None:
                before = _row(session, issued.replaces)
                if before.unit != issued.unit:
                    raise Refused(f"certificate {before.number} is of unit {before.unit!r}")
                wanted = select(CertificateTable.number).where(CertificateTable.replaces == before.number)
                if (by := session.exec(wanted).first()) is not None:
                    raise Refused(f"certificate {before.number} was replaced by {by}: replace that one")
            session.add(CertificateTable(**said, pdf=pdf, dcc=dcc))
            session.flush()
            detail = {
                "number": issued.number,
                "sha256": issued.sha256,
                "replaces": issued.replaces,
                "settings": {name: issued.settings.get(name) for name in STATED},
            }
            act = Act(
                "certificate_issued",
                who=issued.issued_by,
                unit=issued.unit,
                revision=issued.revision,
                reason=issued.reason,
                detail=detail,
            )
            append(session, act, issued.issued_at)
        return issued

    def get(self, number: str) -> IssuedCertificate:
        """A certificate by its number (NotFound without)."""
        found = self._found(col(CertificateTable.number) == number)
        if not found:
            raise NotFound(f"there is no certificate {number!r}")
        return found[0]

    def of(self, unit: str | None = None, number: str | None = None) -> list[IssuedCertificate]:
        """All of a unit, or of all units, or those whose number has a part in it; newest first."""
        conditions = [] if unit is None else [col(CertificateTable.unit) == unit]
        if number is not None:
            conditions.append(col(CertificateTable.number).contains(number.upper(), autoescape=True))
        return self._found(*conditions)

    def content(self, number: str, form: Form) -> bytes | None:
        """Its bytes as issued; None of a PDF that could not be made.

        Raises:
            NotFound: there is no such certificate.
            Unreadable: the bytes are not those that were stored.
        """
        with self._database.reading() as session:
            row = _row(session, number)
            check_bytes(row.number, form, getattr(row, form), row.sha256)
            return row.pdf if form == "pdf" else row.dcc

    def _found(self, *conditions: ColumnElement[bool]) -> list[IssuedCertificate]:
        wanted = select(CertificateTable).options(
            defer(CertificateTable.pdf),  # type: ignore[arg-type]
            defer(CertificateTable.dcc),  # type: ignore[arg-type]
        )
        wanted = wanted.where(*conditions).order_by(
            col(CertificateTable.issued_at).desc(), col(CertificateTable.number)
        )
        replaced = select(CertificateTable.replaces, CertificateTable.number)
        replaced = replaced.where(col(CertificateTable.replaces).is_not(None))
        with self._database.reading() as session:
            by = dict(session.exec(replaced).all())
            return [
                IssuedCertificate.model_validate(row).model_copy(update={"replaced_by": by.get(row.number)})
                for row in session.exec(wanted)
            ]


def _row(session: Session, number: str) -> CertificateTable:
    return row_of(session, CertificateTable, number, f"there is no certificate {number!r}")


def check_bytes(number: str, form: Form, content: bytes | None, sha256: Document) -> None:
    """Refuse bytes that are not those that were issued (Unreadable)."""
    if (None if content is None else hashlib.sha256(content).hexdigest()) != sha256[form]:
        raise Unreadable(f"certificate {number}: its {form.upper()} is not what was issued")
