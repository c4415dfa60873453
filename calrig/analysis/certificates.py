"""What a revision's certificate is made of, gathered from the store."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from calrig.analysis.errors import Conflict
from calrig.analysis.results import rest_on_map
from calrig.analysis.solved_drafts import gone_since, solution_changes, solved_poses
from calrig.analysis.stored_runs import stored_run
from calrig.calibration.uncertainty import Limit
from calrig.export.certificate.content import Certificate
from calrig.export.certificate.making import Sources, certificate_of
from calrig.export.certificate.pdf import Attached, CannotPrintError, pdf_of
from calrig.export.dcc.document import dcc_of
from calrig.export.dcc.signing import signed
from calrig.figures.residual_steps import residual_steps
from calrig.figures.svg import svg_of
from calrig.laboratory import LaboratorySettings
from calrig.store import AcceptedEffect, Run, Store
from calrig.store.issued import Revision
from calrig.store.records import StoredPose
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
            item=store.item(revision.unit, (run.finished_at or run.created_at).date()),
        )
    )


def _poses(store: Store, revision: Revision, run: Run) -> list[StoredPose]:
    """All of its run, as the joint solution has them where it is by one."""
    poses, solution = store.poses(run.id), revision.basis.get("solution")
    return poses if solution is None else solved_poses(store.solution(solution), run, poses)


def _gone(store: Store, revision: Revision, run: Run) -> list[str]:
    """What it rests on that counts no more, a sentence each."""
    if (solution := revision.basis.get("solution")) is not None:
        return solution_changes(store, store.solution(solution))
    gone = gone_since(run, revision.unit)
    return [] if gone is None else [gone]


def _entries(store: Store, revision: Revision) -> list[Entry]:
    """Of the trail, what was done with this revision; the oldest first."""
    what: tuple[What, ...] = ("drafted", "released", "withdrawn")
    of_unit = store.trail(unit=revision.unit, what=what, limit=EVERY_ENTRY)
    return [one for one in of_unit if (one.act.unit, one.act.revision) == (revision.unit, revision.revision)]


def _before(store: Store, revision: Revision, entries: Sequence[Entry]) -> Revision | None:
    """The revision that was in force until this one first was; of a draft, the one that is in force now."""
    first = next((one for one in entries if one.act.what == "released"), None)
    if first is None:
        in_force = store.in_force(revision.unit) if revision.status == "draft" else None
        return None if in_force is None or in_force.revision == revision.revision else in_force
    number = first.act.detail.get("supersedes")
    return None if number is None else store.revision(revision.unit, number)


def _came_with(store: Store, revision: Revision, before: Revision | None) -> Revision | None:
    """The last one in force before it that is of another run: what the unit was calibrated by as it came."""
    seen = {revision.revision}
    while before is not None and before.run_id == revision.run_id and before.revision not in seen:
        seen.add(before.revision)
        before = _before(store, before, _entries(store, before))
    return None if before is None or before.run_id == revision.run_id else before


def _of_stage(store: Store, revision: Revision) -> list[AcceptedEffect]:
    """The rig's effects that it rests on, also those that were taken back since."""
    used = store.accepted_effects([int(number) for number in revision.basis["effects"]])
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
    changes = store.trail(what=["limits_changed"], limit=EVERY_ENTRY)
    before = [one for one in changes if one.at <= when]
    if before:
        return [Limit.from_dict(one) for one in before[-1].act.detail["now"]]
    return [Limit.from_dict(one) for one in changes[0].act.detail["before"]] if changes else store.limits()


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
