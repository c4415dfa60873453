"""Issued calibrations: the one in force byte for byte, every revision, drafts, release and withdrawal."""

from datetime import datetime
from typing import Annotated, Literal, Self, cast

from fastapi import APIRouter, HTTPException, Path, Query
from fastapi.responses import PlainTextResponse, Response
from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticKnownError

from calrig.analysis.calibration_in_force import wanted_revision
from calrig.analysis.certificates import certificate_dcc, certificate_pdf, exported, exported_noise
from calrig.analysis.errors import Invalid
from calrig.analysis.revisions import issued_since
from calrig.api.access import Who
from calrig.api.context import ApiContext, Context, KnownUnit
from calrig.api.jobs import BackgroundWork, Heavy
from calrig.api.models import Body, Reason, ReasonIfAny
from calrig.api.routes import BYTES, CHANGES, TEXT, answers
from calrig.export.formats import NoiseExporter, Source, exporter_of, exporters, format_names
from calrig.model.base import Model
from calrig.model.calibration import Calibration, IssuedAct, Revision
from calrig.store.issued import Revision as StoredRevision

ISSUED = ("json", "pdf", "dcc")
"""What is served beside the formats of other programs: the calibration itself, and its certificates."""


def _format(name: str) -> str:
    known = [*ISSUED, *format_names()]
    if name not in known:
        expected = " or ".join([", ".join(map(repr, known[:-1])), repr(known[-1])])
        raise PydanticKnownError("literal_error", {"expected": expected})
    return name


CalibrationFormat = Annotated[
    str, AfterValidator(_format), Field(json_schema_extra={"enum": [*ISSUED, *format_names()]})
]
Number = Annotated[int, Path(ge=1, lt=2**31)]

router = APIRouter(tags=["calibrations"])


class NewDraft(Body):
    """A run, and which of the unit's accepted effects enter (all without a list); or a joint solution."""

    run_id: Annotated[str, Field(max_length=100)] | None = None
    solve: Annotated[str, Field(max_length=100)] | None = None
    effects: Annotated[list[str], Field(max_length=100)] | None = None
    reason: Annotated[str, Field(max_length=1000)] | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if (self.run_id is None) == (self.solve is None):
            raise ValueError("name a run or a solution, and not both")
        if self.solve is not None and self.effects is not None:
            raise ValueError("a solution has its own effects: leave `effects` out")
        return self


class FormatAnswer(Model):
    """A format of another program that a calibration, or a unit's noise, is written in."""

    name: str
    title: str
    file_name: str = Field(description="Of a file that a person saves.")
    media_type: str
    source: Source = Field(description="The calibration document, or the unit's latest static run.")
    contents: str
    about_one_axis: str = Field(description="What it holds of a calibration about one axis alone.")


@router.get("/api/calibration-formats", **answers(list[FormatAnswer], "Formats of other programs"))
def list_formats() -> object:
    """The names that `format` of a calibration takes beside `json`, `pdf` and `dcc`."""
    return exporters()


# The longer paths come first: `{serial:path}` would take their ends for parts of the serial number.
@router.get(
    "/api/units/{serial:path}/calibration",
    **answers(
        Calibration,
        "The calibration in force",
        404,
        409,
        422,
        501,
        sends={"text/plain": TEXT, "application/pdf": BYTES, "application/xml": TEXT},
    ),
)
def show_calibration(
    serial: str,
    context: Context,
    heavy: Heavy,
    revision: Annotated[str | None, Query(description="A number, or `latest`.")] = None,
    format_: Annotated[CalibrationFormat, Query(alias="format")] = "json",
) -> Response:
    """Byte for byte as it was issued, its hash as `ETag`; 404 while none is.

    `GET /api/calibration-formats` lists the formats of other programs; 409 with the reason where one cannot
    hold the calibration. Formats of source `noise` are of the unit's latest static run, whatever the
    revision.

    `pdf` is a preview of its certificate and says so, `dcc` the same for programs (PTB's XML, signed where
    the laboratory has a key); 501 where what makes it is not installed. `POST …/certificates` issues one.
    """
    exporter = None if format_ in ISSUED else exporter_of(format_)
    if isinstance(exporter, NoiseExporter):
        text = exported_noise(context.store, serial, exporter, heavy.from_thread)
        return PlainTextResponse(text, media_type=exporter.media_type)
    found = wanted_revision(context.store, serial, _wanted(revision))
    headers = {"ETag": f'"{found.sha256}"'}
    if format_ == "json":
        return Response(found.text.encode(), media_type="application/json", headers=headers)
    if exporter is None:
        return _preview(context, heavy, found, "pdf" if format_ == "pdf" else "dcc")
    return PlainTextResponse(exported(found, exporter), headers=headers, media_type=exporter.media_type)


@router.get(
    "/api/units/{serial:path}/calibrations",
    **answers(list[Revision], "Every issued revision, newest first", 404),
)
def list_revisions(unit: KnownUnit, context: Context) -> object:
    """At most one is in force; `stale` says what it rests on that has changed since it was made."""
    return context.issuer.listed(context.store.revisions.of(unit.serial))


@router.post(
    "/api/units/{serial:path}/calibrations/{revision}/release",
    **answers(Revision, "Put a revision in force", *CHANGES, role="releaser"),
)
def release(
    unit: KnownUnit, revision: Number, context: Context, who: Who, body: ReasonIfAny | None = None
) -> object:
    """A draft, or a superseded one again; the one in force until now is superseded.

    422 without a reason, where the revision has warnings.
    """
    reason = None if body is None else body.reason
    released = context.issuer.release(unit.serial, revision, by=who, reason=reason)
    return context.issuer.listed([released])[0]


@router.post(
    "/api/units/{serial:path}/calibrations/{revision}/withdraw",
    **answers(Revision, "Withdraw a revision permanently", *CHANGES, role="releaser"),
)
def withdraw(unit: KnownUnit, revision: Number, body: Reason, context: Context, who: Who) -> object:
    """If it was in force, the unit has no calibration in force afterwards."""
    withdrawn = context.issuer.withdraw(unit.serial, revision, by=who, reason=body.reason)
    return context.issuer.listed([withdrawn])[0]


@router.post(
    "/api/units/{serial:path}/calibrations",
    **answers(
        Revision, "Draft a calibration from a run or a joint solution", *CHANGES, role="operator", status=201
    ),
)
def draft(unit: KnownUnit, body: NewDraft, context: Context, who: Who) -> object:
    """Numbered and frozen; released as the `release` of the run's rig says."""
    if body.run_id is not None:
        made = context.issuer.draft(unit.serial, body.run_id, body.effects, by=who, reason=body.reason)
    else:
        solution = cast(str, body.solve)
        made = context.issuer.draft_solved(unit.serial, solution, by=who, reason=body.reason)
    return context.issuer.listed([made])[0]


@router.get(
    "/api/calibrations",
    **answers(list[IssuedAct], "What was issued, released or withdrawn, oldest first", 422),
)
def list_issued(context: Context, since: datetime | None = None) -> object:
    """Over all units; `since` a time (without a zone, UTC)."""
    return issued_since(context.store, since)


def _preview(
    context: ApiContext, heavy: BackgroundWork, found: StoredRevision, form: Literal["pdf", "dcc"]
) -> Response:
    from calrig.export.certificate.pdf import RendererMissingError
    from calrig.export.signing import SignerMissingError

    make = certificate_pdf if form == "pdf" else certificate_dcc
    ending, kind = ("pdf", "inline") if form == "pdf" else ("xml", "attachment")
    try:
        made = make(context.store, found, context.laboratory, heavy.from_thread)
    except SignerMissingError as error:
        raise HTTPException(501, str(error)) from error
    except RendererMissingError as error:
        raise HTTPException(501, f"{error}; the unit's page prints well from a browser") from error
    name = f"preview-{found.sha256[:12]}-{found.revision}.{ending}"
    named = {"Content-Disposition": f'{kind}; filename="{name}"'}
    return Response(made, media_type=f"application/{ending}", headers=named)


def _wanted(revision: str | None) -> int | Literal["latest"] | None:
    if revision is None or revision == "latest":
        return revision  # type: ignore[return-value]
    if not (revision.isascii() and revision.isdigit() and 0 < int(revision[:11]) < 2**31):
        raise Invalid(f"revision {revision[:40]!r} is neither a number nor `latest`")
    return int(revision)
