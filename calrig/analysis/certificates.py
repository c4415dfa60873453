"""Certificates, archives and exports of a revision, made from the store."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from calrig.analysis.errors import Conflict, Unknown
from calrig.analysis.noise_studies import noise_of_unit
from calrig.analysis.results import rest_on_map
from calrig.analysis.revisions import Issuer
from calrig.analysis.solution_drafts import gone_since, solution_changes, solved_poses
from calrig.analysis.stored_runs import stored_run
from calrig.errors import WorkError
from calrig.export.archive.contents import unit_archive
from calrig.export.certificate.content import Certificate
from calrig.export.certificate.making import Sources, certificate_of
from calrig.export.certificate.pdf import Attached, CannotPrintError, pdf_of
from calrig.export.dcc.document import dcc_of
from calrig.export.dcc.signing import signed
from calrig.export.formats import CalibrationExporter, NoiseExporter
from calrig.export.triads import NotHeldError
from calrig.figures.svg import residual_steps, svg_of
from calrig.laboratory import LaboratorySettings
from calrig.model.verdict import Limit
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.issued import Revision
from calrig.store.records import Document, StoredPose
from calrig.store.trail import Entry, What

EVERY_ENTRY = 1_000_000


def certificate(store: Store, revision: Revision, laboratory: LaboratorySettings) -> Certificate:
    """The content of a revision's certificate."""
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
            came_with=_came_with(store, revision, before),
            of_stage=[] if rest_on_map([one.pose for one in poses]) else _of_stage(store, revision),
            limit=_limit(store, revision),
            entries=entries,
            gone=_gone(store, revision, run),
            item=store.items.of(revision.unit, (run.finished_at or run.created_at).date()),
        )
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


def _came_with(store: Store, revision: Revision, before: Revision | None) -> Revision | None:
    """The last one in force before it that is of another run: the unit's calibration as found."""
    seen = {revision.revision}
    while before is not None and before.run_id == revision.run_id and before.revision not in seen:
        seen.add(before.revision)
        before = _before(store, before, _entries(store, before))
    return None if before is None or before.run_id == revision.run_id else before


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


def certificate_dcc(store: Store, revision: Revision, laboratory: LaboratorySettings) -> bytes:
    """A revision's certificate as a DCC, signed where the laboratory has a key.

    Raises:
        SignerMissingError: what signs is not installed.
        WorkError: key and certificate cannot be signed with.
    """
    made = dcc_of(certificate(store, revision, laboratory), revision.text.encode(), laboratory.country)
    if laboratory.signing_key is None or laboratory.signing_certificate is None:
        return made
    return signed(made, Path(laboratory.signing_key), Path(laboratory.signing_certificate))


def certificate_pdf(store: Store, revision: Revision, laboratory: LaboratorySettings) -> bytes:
    """A revision's certificate as PDF/A-3, the calibration document inside.

    Raises:
        RendererMissingError: what makes PDFs is not installed.
        Conflict: something that it says cannot be printed, and what.
    """
    said = certificate(store, revision, laboratory)
    found = said.residuals
    steps = [(step.title, step.left_deg) for step in found.steps]
    picture = svg_of(residual_steps(found.elevation_deg, found.approach, steps))
    document = revision.text.encode()
    attached = [
        Attached("calibration.json", document, "application/json", "The calibration document as issued"),
        Attached(
            "certificate.xml",
            dcc_of(said, document, laboratory.country),
            "application/xml",
            "This certificate as a DCC",
        ),
    ]
    try:
        return pdf_of(said, picture, attached, laboratory)
    except CannotPrintError as error:
        raise Conflict(f"revision {revision.revision} of unit {revision.unit!r}: {error}") from error


def archive_of(store: Store, serial: str, laboratory: LaboratorySettings) -> Iterator[bytes]:
    """The archive, piece by piece.

    Args:
        store: where the unit is.
        serial: of the unit.
        laboratory: who issues its certificates, as PDF too where that can be made here. They are unsigned:
            not every signature is the same once more.

    Raises:
        Unknown: there is no such unit; at once.
    """
    if store.units.get(serial) is None:
        raise Unknown(f"there is no unit {serial!r}")
    unsigned = laboratory.model_copy(update={"signing_key": None, "signing_certificate": None})

    def certificates(revision: Revision) -> Iterator[tuple[str, bytes]]:
        yield "xml", certificate_dcc(store, revision, unsigned)
        try:
            yield "pdf", certificate_pdf(store, revision, unsigned)
        except (WorkError, Conflict):
            return  # no typst here, or no font for a character: the XML says the same

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
