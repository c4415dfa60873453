"""Certificates as they were issued: numbered, listed, and served byte for byte."""

from typing import Annotated, Literal

from fastapi import APIRouter, HTTPException, Query
from fastapi.responses import Response
from pydantic import Field

from calrig.analysis.calibration_in_force import wanted_revision
from calrig.analysis.certificates import issue_certificate
from calrig.analysis.errors import Unknown
from calrig.api.access import Who
from calrig.api.context import Context, KnownUnit
from calrig.api.jobs import Heavy
from calrig.api.models import Body
from calrig.api.routes import BYTES, CHANGES, TEXT, answers
from calrig.model.base import Model
from calrig.store.certificates import IssuedCertificate

router = APIRouter(tags=["certificates"])


class NewCertificate(Body):
    """Of which revision, and in place of which certificate."""

    revision: Annotated[int, Field(ge=1, lt=2**31)]
    replaces: Annotated[str, Field(max_length=100)] | None = None
    reason: Annotated[str, Field(max_length=1000)] | None = None


class StatedSettings(Model):
    """What the laboratory's settings were, as far as certificates state them."""

    name: str | None = None
    address: str | None = None
    place: str | None = None
    accreditation: str | None = None
    decision_rule: str | None = None
    authorised_by: str | None = None
    country: str | None = None


class CertificateAnswer(IssuedCertificate):
    """A certificate that was issued; its bytes are at `/api/certificates/{number}`."""

    settings: StatedSettings = Field(description="Of the laboratory, when it was issued.")  # type: ignore[assignment]


@router.post(
    "/api/units/{serial:path}/certificates",
    **answers(
        CertificateAnswer,
        "Issue the certificate of a revision",
        *CHANGES,
        429,
        501,
        role="releaser",
        status=201,
    ),
)
def issue(unit: KnownUnit, body: NewCertificate, context: Context, heavy: Heavy, who: Who) -> object:
    """Its bytes are kept for ever; a correction is a new one that names the one it replaces, and why.

    409 for a draft. Without what makes PDFs there is none, and `sha256.pdf` is null.
    """
    from calrig.export.signing import SignerMissingError

    try:
        return issue_certificate(
            context.store,
            wanted_revision(context.store, unit.serial, body.revision),
            context.laboratory,
            by=who,
            replaces=body.replaces,
            reason=body.reason,
            carried_out=heavy.from_thread,
        )
    except SignerMissingError as error:
        raise HTTPException(501, str(error)) from error


@router.get("/api/certificates", **answers(list[CertificateAnswer], "Issued certificates, newest first", 422))
def list_certificates(
    context: Context,
    unit: Annotated[str | None, Query(description="Of this unit alone.")] = None,
    number: Annotated[
        str | None, Query(min_length=1, max_length=100, description="Whose number has this in it.")
    ] = None,
) -> object:
    """Also those that were replaced."""
    return context.store.certificates.of(unit, number)


@router.get(
    "/api/certificates/{number}",
    **answers(
        None,
        "A certificate as issued",
        404,
        422,
        sends={"application/pdf": BYTES, "application/xml": TEXT, "application/json": {}},
    ),
)
def show_certificate(
    number: str,
    context: Context,
    format_: Annotated[Literal["pdf", "dcc", "json"], Query(alias="format")] = "pdf",
) -> Response:
    """Byte for byte, its hash as `ETag`; 404 of a PDF that could not be made."""
    found = context.store.certificates.get(number)
    if format_ == "json":
        content: bytes | None = wanted_revision(context.store, found.unit, found.revision).text.encode()
    else:
        content = context.store.certificates.content(number, format_)
    if content is None:
        raise Unknown(f"certificate {number} was issued without a PDF: take format=dcc")
    ending = "xml" if format_ == "dcc" else format_
    kind = "inline" if format_ == "pdf" else "attachment"
    headers = {
        "ETag": f'"{found.sha256[format_]}"',
        "Content-Disposition": f'{kind}; filename="certificate-{number}.{ending}"',
    }
    return Response(content, media_type=f"application/{ending}", headers=headers)
