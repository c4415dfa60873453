"""Certificates, archives and exports of a revision, made from the store."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from operator import call
from pathlib import Path
from typing import Any, cast, get_args

from calrig.analysis.certificate_forms import Forms, forms_of
from calrig.analysis.errors import Conflict, Invalid
from calrig.analysis.noise_studies import noise_of_unit
from calrig.analysis.results import rest_on_map
from calrig.analysis.revisions import Issuer
from calrig.analysis.solution_drafts import gone_since, solution_changes, solved_poses
from calrig.analysis.stored_runs import known_unit, stored_run
from calrig.export.archive.contents import unit_archive
from calrig.export.archive.layout import certificate_name
from calrig.export.certificate.content import Certificate, Issue
from calrig.export.certificate.making import Sources, certificate_of
from calrig.export.certificate.pdf import CannotPrintError, has_renderer, require_renderer
from calrig.export.formats import CalibrationExporter, NoiseExporter
from calrig.export.triads import NotHeldError
from calrig.laboratory import LaboratorySettings
from calrig.model.verdict import Limit
from calrig.processes.pool import OffloadedCall
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.certificates import Form, IssuedCertificate
from calrig.store.issued import Revision
from calrig.store.records import Document, StoredPose
from calrig.store.trail import EVERY_ENTRY, Entry, What


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
    return [one for one in of_unit if (one.unit, one.revision) == (revision.unit, revision.revision)]


def _before(store: Store, revision: Revision, entries: Sequence[Entry]) -> Revision | None:
    """The revision that was in force until this one first was; of a draft, the one that is in force now."""
    first = next((one for one in entries if one.what == "released"), None)
    if first is None:
        in_force = store.revisions.in_force(revision.unit) if revision.status == "draft" else None
        return None if in_force is None or in_force.revision == revision.revision else in_force
    number = first.detail.get("supersedes")
    return None if number is None else store.revisions.get(revision.unit, number)


def _came_with(store: Store, revision: Revision, run: Run) -> Revision | None:
    """The revision that was in force when the run began, by which the unit is found; None if none was."""
    what: tuple[What, ...] = ("released", "withdrawn")
    in_force: int | None = None
    for entry in store.trail.entries(unit=revision.unit, what=what, limit=EVERY_ENTRY):
        if entry.at > (run.started_at or run.created_at):
            break
        if entry.unit != revision.unit:
            continue  # of a run that was moved away
        if entry.what == "released":
            in_force = entry.revision
        elif in_force == entry.revision:
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
        return [Limit.model_validate(one) for one in before[-1].detail["now"]]
    return (
        [Limit.model_validate(one) for one in changes[0].detail["before"]] if changes else store.limits.all()
    )


def certificate_dcc(
    store: Store, revision: Revision, laboratory: LaboratorySettings, carried_out: OffloadedCall = call
) -> bytes:
    """A preview of a revision's certificate as a DCC, signed where the laboratory has a key.

    Raises:
        SignerMissingError: what signs is not installed.
        WorkError: key and certificate cannot be signed with.
    """
    said = certificate(store, revision, laboratory)
    return _forms(said, revision, laboratory, carried_out, printed=False).dcc


def certificate_pdf(
    store: Store, revision: Revision, laboratory: LaboratorySettings, carried_out: OffloadedCall = call
) -> bytes:
    """A preview of a revision's certificate as PDF/A-3, the calibration document and its DCC inside.

    Raises:
        RendererMissingError: what makes PDFs is not installed.
        Conflict: something that it says cannot be printed, and what.
    """
    require_renderer()  # before a process is asked
    made = _forms(certificate(store, revision, laboratory), revision, laboratory, carried_out, printed=True)
    return cast(bytes, made.pdf)


def _forms(
    said: Certificate,
    revision: Revision,
    laboratory: LaboratorySettings,
    carried_out: OffloadedCall,
    *,
    printed: bool,
) -> Forms:
    try:
        return carried_out(partial(forms_of, said, revision.text.encode(), laboratory, printed=printed))
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
    carried_out: OffloadedCall = call,
) -> IssuedCertificate:
    """Issue the certificate of a revision: its bytes and its entry in the trail are kept for ever.

    `revision` is no draft. The laboratory's settings are kept beside; `by` is None where nobody is known by
    name. It corrects the certificate `replaces` for that `reason`; `carried_out` makes the documents.

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
    made = _forms(said, revision, laboratory, carried_out, printed=has_renderer())
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
            "pdf": None if made.pdf is None else hashlib.sha256(made.pdf).hexdigest(),
            "dcc": hashlib.sha256(made.dcc).hexdigest(),
            "json": hashlib.sha256(revision.text.encode()).hexdigest(),
        },
        trail_seq=issue.trail_seq,
        trail_sha256=issue.trail_sha256,
    )
    return store.certificates.add(issued, made.pdf, made.dcc, revision.status)


def archive_of(store: Store, serial: str) -> Iterator[bytes]:
    """The archive, piece by piece, with every certificate that was issued.

    Raises:
        Unknown: there is no such unit; at once.
    """
    known_unit(store, serial)

    def certificates(numbers: Sequence[str]) -> Iterator[tuple[str, bytes]]:
        for number in numbers:
            for form in get_args(Form):
                if (content := store.certificates.content(number, form)) is not None:
                    yield certificate_name(number, form), content

    return unit_archive(store, serial, Issuer(store).listed, certificates)


def write_archive(serial: str, file: Path, store: Store) -> None:
    """Write the archive into a file that is there; errors as of `archive_of`, and OSError."""
    with file.open("wb") as written:
        for piece in archive_of(store, serial):
            written.write(piece)


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
    carried_out: Callable[[Callable[[], Document]], Document] = call,
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
