"""Certificates, archives and exports of a revision, made from the store."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, get_args

from calrig.analysis.errors import Conflict, Invalid, Unknown
from calrig.analysis.noise_studies import noise_of_unit
from calrig.analysis.results import rest_on_map
from calrig.analysis.revisions import Issuer
from calrig.analysis.solution_drafts import gone_since, solution_changes, solved_poses
from calrig.analysis.stored_runs import stored_run
from calrig.export.archive.contents import unit_archive
from calrig.export.archive.layout import certificate_name
from calrig.export.certificate.content import Certificate, Issue
from calrig.export.certificate.making import Sources, certificate_of
from calrig.export.certificate.pdf import (
    Attached,
    CannotPrintError,
    RendererMissingError,
    pdf_of,
    require_renderer,
)
from calrig.export.dcc.document import dcc_of
from calrig.export.dcc.signing import signed
from calrig.export.formats import CalibrationExporter, NoiseExporter
from calrig.export.triads import NotHeldError
from calrig.figures.svg import residual_steps, svg_of
from calrig.laboratory import LaboratorySettings
from calrig.model.verdict import Limit
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.certificates import Form, IssuedCertificate
from calrig.store.issued import Revision
from calrig.store.records import Document, StoredPose
from calrig.store.trail import Entry, What

EVERY_ENTRY = 1_000_000


def certificate(
    store: Store, revision: Revision, laboratory: LaboratorySettings, issue: Issue | None = None
) -> Certificate:
    """The content of a revision's certificate; without `issue` of a preview."""
    run = stored_run(store, revision.run_id)
    entries, poses = _entries(store, revision), _poses(store, revision, run)
    before = _before(store, revision, entries)
    return certificate_of(
        Sources(
            revision=revision,
            run=run,
            poses=poses,
            laboratory=laboratory,
            before=before,
            came_with=_came_with(store, revision, run),
            of_stage=[] if rest_on_map([one.pose for one in poses]) else _of_stage(store, revision),
            limit=_limit(store, revision),
            entries=entries,
            gone=_gone(store, revision, run),
            item=store.items.of(revision.unit, (run.finished_at or run.created_at).date()),
        ),
        issue,
    )


def _poses(store: Store, revision: Revision, run: Run) -> list[StoredPose]:
    """All of its run, as the joint solution has them where it is by one."""
    poses, solution = store.poses.of(run.id), revision.basis.get("solution")
    return poses if solution is None else solved_poses(store.solutions.get(solution), run, poses)


def _gone(store: Store, revision: Revision, run: Run) -> list[str]:
    """What it rests on that counts no more, a sentence each."""
    if (solution := revision.basis.get("solution")) is not None:
        return solution_changes(store, store.solutions.get(solution))
    gone = gone_since(run, revision.unit)
    return [] if gone is None else [gone]


def _entries(store: Store, revision: Revision) -> list[Entry]:
    """Of the trail, what was done with this revision; the oldest first."""
    what: tuple[What, ...] = ("drafted", "released", "withdrawn")
    of_unit = store.trail.entries(unit=revision.unit, what=what, limit=EVERY_ENTRY)
    return [one for one in of_unit if (one.act.unit, one.act.revision) == (revision.unit, revision.revision)]


def _before(store: Store, revision: Revision, entries: Sequence[Entry]) -> Revision | None:
    """The revision that was in force until this one first was; of a draft, the one that is in force now."""
    first = next((one for one in entries if one.act.what == "released"), None)
    if first is None:
        in_force = store.revisions.in_force(revision.unit) if revision.status == "draft" else None
        return None if in_force is None or in_force.revision == revision.revision else in_force
    number = first.act.detail.get("supersedes")
    return None if number is None else store.revisions.get(revision.unit, number)


def _came_with(store: Store, revision: Revision, run: Run) -> Revision | None:
    """The revision that was in force when the run began, by which the unit is found; None if none was."""
    what: tuple[What, ...] = ("released", "withdrawn")
    in_force: int | None = None
    for entry in store.trail.entries(unit=revision.unit, what=what, limit=EVERY_ENTRY):
        if entry.at > (run.started_at or run.created_at):
            break
        if entry.act.unit != revision.unit:
            continue  # of a run that was moved away
        if entry.act.what == "released":
            in_force = entry.act.revision
        elif in_force == entry.act.revision:
            in_force = None
    return None if in_force is None else store.revisions.get(revision.unit, in_force)


def _of_stage(store: Store, revision: Revision) -> list[AcceptedEffect]:
    """The rig's effects that it rests on, also those that were taken back since."""
    used = store.effects.by_id([int(number) for number in revision.basis["effects"]])
    return [effect for effect in used if effect.unit is None]


def _limit(store: Store, revision: Revision) -> Limit | None:
    """The limit that its verdict names, as it was then."""
    named = revision.verdict["limit"]
    if named is None:
        return None
    limits = _limits_at(store, revision.issued_at)
    return next((one for one in limits if one.name == named), None)


def _limits_at(store: Store, when: datetime) -> list[Limit]:
    """The limits as the trail has them of a time; those of today, where nobody ever changed them."""
    changes = store.trail.entries(what=["limits_changed"], limit=EVERY_ENTRY)
    before = [one for one in changes if one.at <= when]
    if before:
        return [Limit.model_validate(one) for one in before[-1].act.detail["now"]]
    return (
        [Limit.model_validate(one) for one in changes[0].act.detail["before"]]
        if changes
        else store.limits.all()
    )


Heavy = Callable[[Callable[[], bytes]], bytes]
"""Carries out what takes seconds, in a process of its own or here."""


def _here(function: Callable[[], bytes]) -> bytes:
    return function()


def certificate_dcc(
    store: Store, revision: Revision, laboratory: LaboratorySettings, issue: Issue | None = None
) -> bytes:
    """A revision's certificate as a DCC, signed where the laboratory has a key; without `issue` a preview.

    Raises:
        SignerMissingError: what signs is not installed.
        WorkError: key and certificate cannot be signed with.
    """
    return _signed_dcc(certificate(store, revision, laboratory, issue), revision, laboratory)


def _signed_dcc(said: Certificate, revision: Revision, laboratory: LaboratorySettings) -> bytes:
    made = dcc_of(said, revision.text.encode(), laboratory.country)
    if laboratory.signing_key is None or laboratory.signing_certificate is None:
        return made
    return signed(made, Path(laboratory.signing_key), Path(laboratory.signing_certificate))


def certificate_pdf(
    store: Store, revision: Revision, laboratory: LaboratorySettings, carried_out: Heavy = _here
) -> bytes:
    """A preview of a revision's certificate as PDF/A-3, the calibration document and its DCC inside.

    Raises:
        RendererMissingError: what makes PDFs is not installed.
        Conflict: something that it says cannot be printed, and what.
    """
    said = certificate(store, revision, laboratory)
    return _pdf(said, _signed_dcc(said, revision, laboratory), revision, laboratory, carried_out)


def _pdf(
    said: Certificate, dcc: bytes, revision: Revision, laboratory: LaboratorySettings, carried_out: Heavy
) -> bytes:
    require_renderer()  # before a process is asked
    found = said.residuals
    steps = [(step.title, step.left_deg) for step in found.steps]
    picture = svg_of(residual_steps(found.elevation_deg, found.approach, steps))
    document = revision.text.encode()
    attached = [
        Attached("calibration.json", document, "application/json", "The calibration document as issued"),
        Attached("certificate.xml", dcc, "application/xml", "This certificate as a DCC"),
    ]
    try:
        return carried_out(partial(pdf_of, said, picture, attached, laboratory))
    except CannotPrintError as error:
        raise Conflict(f"revision {revision.revision} of unit {revision.unit!r}: {error}") from error


def issue_certificate(
    store: Store,
    revision: Revision,
    laboratory: LaboratorySettings,
    *,
    by: str | None = None,
    replaces: str | None = None,
    reason: str | None = None,
    carried_out: Heavy = _here,
) -> IssuedCertificate:
    """Issue the certificate of a revision: its bytes and its entry in the trail are kept for ever.

    Args:
        store: where the revision is.
        revision: not a draft.
        laboratory: who issues it; its settings are kept beside.
        by: who issues it; None where nobody is known by name.
        replaces: number of the certificate that it corrects.
        reason: why that is corrected.
        carried_out: carries out the typesetting.

    Raises:
        Invalid: it replaces one and no reason is given.
        Unknown: there is no certificate of that number.
        Conflict: the revision is a draft or withdrawn, or the certificate was replaced already.
        Refused: the revision was released, superseded or withdrawn while the bytes were made.
        WorkError: it cannot be signed with the laboratory's key.
    """
    if revision.status in ("draft", "withdrawn"):
        state = "a draft: release it first" if revision.status == "draft" else "withdrawn"
        raise Conflict(f"revision {revision.revision} of unit {revision.unit!r} is {state}")
    if replaces is not None and not (reason or "").strip():
        raise Invalid("a certificate that replaces another needs the reason", fields=("reason",))
    issue = Issue(datetime.now(UTC), by, replaces, reason, *store.trail.head())
    said = certificate(store, revision, laboratory, issue)
    dcc = _signed_dcc(said, revision, laboratory)
    try:
        pdf = _pdf(said, dcc, revision, laboratory, carried_out)
    except RendererMissingError:
        pdf = None
    issued = IssuedCertificate(
        number=said.number,
        unit=revision.unit,
        revision=revision.revision,
        issued_at=issue.at,
        issued_by=by,
        replaces=replaces,
        reason=reason,
        settings=laboratory.model_dump(mode="json"),
        sha256={
            "pdf": None if pdf is None else hashlib.sha256(pdf).hexdigest(),
            "dcc": hashlib.sha256(dcc).hexdigest(),
            "json": hashlib.sha256(revision.text.encode()).hexdigest(),
        },
        trail_seq=issue.trail_seq,
        trail_sha256=issue.trail_sha256,
    )
    return store.certificates.add(issued, pdf, dcc, revision.status)


def archive_of(store: Store, serial: str) -> Iterator[bytes]:
    """The archive, piece by piece, with every certificate that was issued.

    Raises:
        Unknown: there is no such unit; at once.
    """
    if store.units.get(serial) is None:
        raise Unknown(f"there is no unit {serial!r}")

    def certificates(numbers: Sequence[str]) -> Iterator[tuple[str, bytes]]:
        for number in numbers:
            for form in get_args(Form):
                if (content := store.certificates.content(number, form)) is not None:
                    yield certificate_name(number, form), content

    return unit_archive(store, serial, Issuer(store).listed, certificates)


def exported(revision: Revision, exporter: CalibrationExporter) -> str:
    """A revision in the format of another program.

    Raises:
        Conflict: the format cannot hold what the revision says.
    """
    return exported_document(
        revision.document, exporter, f"revision {revision.revision} of unit {revision.unit!r}"
    )


def exported_document(document: Mapping[str, Any], exporter: CalibrationExporter, what: str) -> str:
    """A document in such a format, as `exported`; `what` names the document in a refusal."""
    try:
        return exporter.write(document)
    except ValueError as error:
        raise Conflict(f"{what} cannot be written as {exporter.title}: {error}") from error


def exported_noise(
    store: Store,
    unit: str,
    exporter: NoiseExporter,
    carried_out: Callable[[Callable[[], Document]], Document] = lambda function: function(),
) -> str:
    """The noise of a unit's latest static log in the format of another program; as `noise_of_unit`.

    Raises:
        Conflict: there is no such log, or it does not show what the format needs.
    """
    report, run = noise_of_unit(store, unit, carried_out)
    try:
        return exporter.write(report, f"unit {unit}, static run {run.id}")
    except NotHeldError as error:
        raise Conflict(f"run {run.id}: {error}") from error
